import jax.numpy as jnp
import jax.random as jr
import numpy as np

from hiprl.control.gradient import GradientConfig
from hiprl.control.search import new_search, search
from hiprl.models.reward import EstimatedReward, Gap
from tests.control.known import known
from tests.data.samples import N, q, set_of, trajectory

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


def test_a_trial_lasts_no_longer_than_an_episode():
    state = new_search(T_of(2), q, CONFIG, key=jr.key(1))
    _, report = search(known(), ONE, None, T_of(2), state, CONFIG, key=jr.key(2))
    assert float(report.imagined) == H
