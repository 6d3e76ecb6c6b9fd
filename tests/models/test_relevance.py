import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.features import OWN, WAVES, by_entry, size_of, waves
from hiprl.models.relevance import SIZE, relevance_of, shares_of, spread_by
from hiprl.models.reward import AdditiveConfig, estimate_additive_reward
from tests.data.samples import answers

N = 5


def noise_set(n, *, seed, H=31, p=9, q=3, varied=False):
    """Trajectories through noise; by actions that are smaller in some of them, if so asked."""
    rng = np.random.default_rng(seed)
    size = lambda: rng.uniform() if varied else 1.0
    arrays = lambda: (rng.normal(size=(H + 1, p)), size() * rng.uniform(-1, 1, size=(H, q)), np.zeros(H))
    taus = [
        Trajectory(*(jnp.asarray(x, jnp.float32) for x in arrays()), jnp.asarray(H, jnp.int32), jnp.asarray(False))
        for _ in range(n)
    ]
    rows = jax.tree.map(lambda *x: jnp.stack(x), *taus)
    return Trajectories(rows, jnp.asarray(n, jnp.int32))


@pytest.fixture(scope="module")
def rng():
    return np.random.default_rng(3)


def test_the_size_of_a_function_is_its_variance_for_a_standard_normal(rng):
    x = rng.normal(size=200_000)
    phi = np.stack([x, x**2, *map(np.asarray, waves(jnp.asarray(x, jnp.float32)))], axis=1)
    for _ in range(5):
        w = rng.normal(size=OWN + WAVES)
        assert np.sum((w @ SIZE) ** 2) == pytest.approx(np.var(phi @ w), rel=0.03)


def test_each_weight_belongs_to_its_entry():
    D = size_of(N)
    entries = np.asarray(by_entry(jnp.arange(D, dtype=jnp.float32)))
    assert entries[:, 0].tolist() == list(range(1, 1 + N)) and entries[:, 1].tolist() == list(range(1 + N, 1 + 2 * N))
    assert sorted(entries.ravel()) == list(range(1, D))
    spread = spread_by(jnp.ones(D), jnp.arange(1.0, 1 + N))
    assert spread[0] == 1
    np.testing.assert_array_equal(by_entry(spread), np.tile(np.arange(1.0, 1 + N)[:, None], (1, OWN + WAVES)))


def test_where_nothing_was_learned_all_are_as_relevant_as_before():
    D, even = size_of(N), jnp.ones(N)
    found = relevance_of(shares_of(jnp.zeros(D), jnp.ones(D), jnp.zeros((3, D)), even), freedom=0.2)
    np.testing.assert_allclose(found, even, rtol=1e-5)


def test_what_explains_something_is_more_relevant_and_what_is_known_to_do_nothing_less():
    D = size_of(N)
    mean = jnp.zeros(D).at[2].set(3.0)
    root = jnp.zeros((2, D)).at[0, 4].set(1.0)  # entry 3's slope is known to be 0
    prior = jnp.where(jnp.arange(D) <= N, 1.0, 1e-9)
    few, more = (relevance_of(shares_of(mean, prior, root, jnp.ones(N)), freedom=freedom) for freedom in (0.2, 1.0))
    for found in few, more:
        assert int(jnp.argmax(found)) == 1 and int(jnp.argmin(found)) == 3
    assert float(few[1]) > 10 * float(few[3])
    assert float(more[1] / more[3]) < float(few[1] / few[3])


def test_one_entry_is_found_by_fewer_answers_than_there_are_entries():
    T, new = noise_set(8, seed=1), noise_set(8, seed=2)
    paid = lambda T: np.asarray(T.rows.states[:, :-1, 1], float).sum(axis=1)
    P = answers([(k + 1, k) for k in range(7)], np.diff(paid(T)), capacity=7)
    reward = estimate_additive_reward(P, T, AdditiveConfig())
    slopes = np.abs(np.asarray(reward.mean[1:13]))
    assert slopes[1] > 3 * np.delete(slopes, 1).max()
    assert np.corrcoef(np.asarray(reward.returns(new)), paid(new))[0, 1] > 0.95


@pytest.mark.parametrize("seed", [1, 7])
def test_what_is_wanted_is_found_beside_the_effort_that_explains_most(seed):
    T, new = (noise_set(8, seed=seed, H=200, varied=True) for seed in (seed, seed + 100))
    effort = lambda T: (np.asarray(T.rows.actions, float) ** 2).sum(axis=(1, 2))
    paid = lambda T: np.asarray(T.rows.states[:, :-1, 1], float).sum(axis=1) - 0.1 * effort(T)
    P = answers([(k + 1, k) for k in range(5)], np.diff(paid(T))[:5], capacity=7)
    reward = estimate_additive_reward(P, T, AdditiveConfig())
    assert np.corrcoef(np.asarray(reward.returns(new)), paid(new))[0, 1] > 0.95
