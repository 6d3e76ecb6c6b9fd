import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from hiprl.control.gradient import GradientConfig
from hiprl.control.search import new_search, search
from hiprl.models.reward import EstimatedReward, Gap
from tests.control.known import known
from tests.data.samples import N, p, q, set_of, trajectory

H = 7
CONFIG = GradientConfig(hidden=(8,), chunks=1, updates=2, rollouts=2, steps=2, trial_steps=23, trial_starts=2)


class One(EstimatedReward):
    """A reward of 1 a step."""

    def __call__(self, s, a):
        return 1.0 + 0 * s[0]

    def gap(self, tau, other):
        return Gap(jnp.zeros(()), jnp.ones(()))

    def returns(self, T):
        return jnp.where(T.filled, 1.0 * H, -jnp.inf)


ONE = One(jnp.ones(()))


def T_of(n):
    rng = np.random.default_rng(3)
    return set_of([trajectory(rng) for _ in range(n)])


def test_a_search_compiles_once_while_the_data_grow():
    state = new_search(T_of(2), q, CONFIG, key=jr.key(1))
    before = None
    for n in range(2, 6):
        state, report = search(known(), ONE, None, T_of(n), state, CONFIG, key=jr.key(n))
        assert report.finite
        before = before or search._cache_size()
    assert search._cache_size() == before


def test_no_padding_is_imagined_from():
    state = new_search(T_of(3), q, CONFIG, key=jr.key(1))
    state, report = search(known(), ONE, None, T_of(3), state, CONFIG, key=jr.key(2))
    assert report.finite and all(np.isfinite(x).all() for x in (state.policy.inputs.mean, state.value.scale))
    assert T_of(3).capacity == N  # there is padding, and it is NaN


class At(One):
    """A reward of 1 a step, and one that spoils all numbers at a state that was never seen."""

    def __call__(self, s, a):
        return jnp.where(jnp.abs(s[0] - 40) < 1e-3, jnp.nan, 1.0)


def test_it_is_imagined_from_where_the_world_says_one_can_be():
    state = new_search(T_of(2), q, CONFIG, key=jr.key(1))
    more = {"anywhere": jnp.full((5, p), 40.0), "key": jr.key(2)}
    after, _ = search(known(), At(jnp.ones(())), None, T_of(2), state, CONFIG, **more)
    assert any(np.isnan(x).any() for x in jax.tree.leaves(eqx.filter(after, eqx.is_inexact_array)))


class Cliff(One):
    """A reward of 1 a step, and one that spoils all numbers where a policy has run away."""

    def __call__(self, s, a):
        return jnp.where(jnp.abs(s[0]) > 50, -jnp.inf, 1.0) + 0.1 * s[1]


def test_nothing_is_imagined_from_where_one_policy_ran_away():
    rng = np.random.default_rng(3)
    away = trajectory(rng, low=500.0, high=600.0)
    away = eqx.tree_at(lambda tau: tau.states, away, away.states.at[0].set(0.0))
    T = set_of([*(trajectory(rng) for _ in range(5)), away])
    state = new_search(T, q, CONFIG, key=jr.key(1))
    state, report = search(known(), Cliff(jnp.ones(())), None, T, state, CONFIG, key=jr.key(2))
    numbers = jax.tree.leaves(eqx.filter((state.policy, state.value), eqx.is_inexact_array))
    assert report.finite and all(np.isfinite(x).all() for x in numbers)


def test_a_trial_lasts_no_longer_than_an_episode():
    state = new_search(T_of(2), q, CONFIG, key=jr.key(1))
    _, report = search(known(), ONE, None, T_of(2), state, CONFIG, key=jr.key(2))
    assert float(report.imagined) == H
