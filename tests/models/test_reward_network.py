import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.models.reward_network import NetworkConfig, estimate_network_reward, new_network_reward
from tests.data.samples import answers, clean, p, q
from tests.models.worlds import linear_set, steps_of

H, N, K = 7, 17, 13
CONFIG = NetworkConfig(members=3, hidden=(16,), steps=300)
PAIRS = [(i + 1, (5 * i) % (i + 1)) for i in range(11)]


def truth(s, a):
    return 2 * s[:, 0] - a[:, 1]


@pytest.fixture(scope="module")
def T():
    return linear_set(31, [7, 3, 7, 5, 7, 7, 2, 7, 7, 6, 7, 7], H=H, capacity=N)


@pytest.fixture(scope="module")
def P(T):
    J = [truth(*steps_of(T, i)).sum() for i in range(12)]
    return answers(PAIRS, [J[i] - J[j] for i, j in PAIRS], capacity=K)


@pytest.fixture(scope="module")
def blank(T):
    return new_network_reward(T, CONFIG, key=jr.key(1))


@pytest.fixture(scope="module")
def learned(T, P, blank):
    return estimate_network_reward(P, T, blank, CONFIG)


def loss(reward, T, P):
    """Eq. (59) for each network, by a plain loop."""
    each = jax.jit(jax.vmap(reward.each))
    sums = []
    for i in range(int(T.count)):
        n = int(T.rows.length[i])
        r = each(np.nan_to_num(np.asarray(T.rows.states[i])[:-1]), np.nan_to_num(np.asarray(T.rows.actions[i])))
        sums.append(np.asarray(r, float)[:n].sum(0))
    error = [float(P.g[k]) - (sums[i] - sums[j]) for k, (i, j) in enumerate(PAIRS)]
    return np.mean(np.square(error), axis=0)


def test_training_brings_the_loss_of_eq_59_down(T, P, blank, learned):
    assert (loss(learned, T, P) < 0.02 * loss(blank, T, P)).all()


def test_training_goes_on_from_the_weights_there_are(T, P, learned):
    again = estimate_network_reward(P, T, learned, CONFIG)
    assert loss(again, T, P).mean() < loss(learned, T, P).mean()


def test_the_reward_is_the_mean_of_the_networks_and_sigma_g_their_spread(T, learned):
    s, a = (jnp.asarray(x[0], jnp.float32) for x in steps_of(T, 2))
    assert float(learned(s, a)) == pytest.approx(float(np.mean(learned.each(s, a))), rel=1e-4)
    by_net = np.asarray(learned.sums(T.get(4)), float) - np.asarray(learned.sums(T.get(6)), float)
    gap = learned.gap(T.get(4), T.get(6))
    assert float(gap.mean) == pytest.approx(by_net.mean(), rel=1e-3)
    assert float(gap.sigma) == pytest.approx(by_net.std(ddof=1), rel=1e-3)


def test_new_trajectories_are_ranked(learned):
    new = linear_set(79, [H] * 13, H=H, capacity=N)
    J = [truth(*steps_of(new, i)).sum() for i in range(13)]
    assert np.corrcoef(np.asarray(learned.returns(new))[:13], J)[0, 1] > 0.8


def test_padding_changes_nothing(T, P, learned):
    again = estimate_network_reward(P, clean(T), new_network_reward(clean(T), CONFIG, key=jr.key(1)), CONFIG)
    for x, y in zip(jax.tree.leaves(learned), jax.tree.leaves(again), strict=True):
        assert np.isfinite(x).all()
        np.testing.assert_array_equal(x, y)


def test_networks_see_states_and_actions_only(blank):
    assert blank.nets.weights[0].shape == (3, p + q, 16)
