import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiprl.data.preference import Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models import reward as module
from hiprl.models.features import BOWED, spectrum
from hiprl.models.reward import AdditiveConfig, estimate_additive_reward
from tests.data.samples import answers, clean, p, q
from tests.models.worlds import linear_set, steps_of

H, N, K = 31, 17, 13
ONE = AdditiveConfig(smooth=(1.0,), lengths=(4.0,), noise=(1e-4,))
EXACT = AdditiveConfig(smooth=(1.0,), lengths=(4.0,), noise=(1e-6,))
PAIRS = [(i + 1, (7 * i) % (i + 1)) for i in range(11)]


def linear_truth(s, a):
    return 2 * s[:, 0] - s[:, 2] + 0.5 * a[:, 1]


def bent_truth(s, a):
    return -((s[:, 0] - 0.5) ** 2) - 0.3 * a[:, 0] ** 2


def returns_of(T, truth):
    return [float(truth(*steps_of(T, i)).sum()) for i in range(int(T.count))]


def said(T, truth, pairs=PAIRS):
    """P with the true answers to these pairs."""
    J = returns_of(T, truth)
    return answers(pairs, [J[i] - J[j] for i, j in pairs], capacity=K)


@pytest.fixture(scope="module")
def T():
    """Twelve trajectories of equal length."""
    return linear_set(21, [H] * 12, H=H, capacity=N)


@pytest.fixture(scope="module")
def uneven():
    """Twelve trajectories of unequal length."""
    return linear_set(22, [31, 7, 19, 3, 29, 11, 23, 5, 17, 13, 2, 30], H=H, capacity=N)


@pytest.fixture(scope="module")
def gap():
    compiled = jax.jit(lambda reward, tau, other: reward.gap(tau, other))
    return lambda reward, T, i, j: tuple(map(float, compiled(reward, T.get(i), T.get(j))))


def long_way(reward, T, pairs, g, config):
    """Prior, noise and Ψ in float64: sums of features by a plain loop, scales by their definitions."""
    phi = jax.jit(jax.vmap(reward.features))
    Phi = [np.asarray(phi(*(jnp.asarray(x, jnp.float32) for x in padded(T, i))), float) for i in range(int(T.count))]
    Phi = np.array([x[: int(T.rows.length[i])].sum(0) for i, x in enumerate(Phi)])
    Psi = np.array([Phi[i] - Phi[j] for i, j in pairs])
    (smooth,), (share,), n = config.smooth, config.noise, p + q
    relevance = np.asarray(reward.prior[1 : 1 + n], float)
    relevance /= relevance.mean()
    smooth_part = np.outer(relevance, smooth * spectrum(4.0)).reshape(-1)
    prior = np.concatenate([[n * (1 + smooth)], relevance, smooth * BOWED * relevance, smooth_part])
    gram = (Psi * prior) @ Psi.T
    noise = share * np.trace(gram) / len(g)
    scale = g @ np.linalg.solve(gram + noise * np.eye(len(g)), g) / len(g)
    return Phi, Psi, scale * prior, scale * noise


def padded(T, i):
    """States and actions of a trajectory as they are kept, without NaN: one shape for all."""
    return np.nan_to_num(np.asarray(T.rows.states[i])[:-1]), np.nan_to_num(np.asarray(T.rows.actions[i]))


def posterior(Psi, g, prior, noise):
    """Mean and covariance of the weights, by inverting the sum of the precisions."""
    S = np.linalg.inv(np.diag(1 / prior) + Psi.T @ Psi / noise)
    return S @ Psi.T @ g / noise, S


@pytest.mark.parametrize("name", ["T", "uneven"])
def test_the_posterior_is_the_one_worked_out_the_long_way(request, gap, name):
    T = request.getfixturevalue(name)
    P = said(T, bent_truth)
    reward = estimate_additive_reward(P, T, ONE)
    g = np.asarray(P.g, float)[: len(PAIRS)]
    Phi, Psi, prior, noise = long_way(reward, T, PAIRS, g, ONE)
    np.testing.assert_allclose(reward.prior, prior, rtol=2e-3)
    mean, S = posterior(Psi, g, prior, noise)
    for i in range(12):
        for j in (0, 3, 8):
            psi = Phi[i] - Phi[j]
            found, sigma = gap(reward, T, i, j)
            assert found == pytest.approx(psi @ mean, rel=1e-2, abs=1e-2 * np.std(g))
            wide = np.sqrt(psi @ (prior * psi))
            assert sigma == pytest.approx(np.sqrt(psi @ S @ psi), rel=2e-2, abs=2e-3 * wide)


def test_answers_without_error_are_given_back(T, gap):
    P = said(T, linear_truth)
    reward = estimate_additive_reward(P, T, EXACT)
    spread = np.std(np.asarray(P.g)[: len(PAIRS)])
    for (i, j), g in zip(PAIRS, np.asarray(P.g), strict=False):
        found, sigma = gap(reward, T, i, j)
        assert abs(found - g) < 0.02 * spread and sigma < 0.05 * spread


def test_a_reward_is_learned_well_enough_to_rank_new_trajectories(T):
    reward = estimate_additive_reward(said(T, linear_truth), T, AdditiveConfig())
    new = linear_set(77, [H] * 7, H=H, capacity=N)
    predicted = np.asarray(reward.returns(new))[:7]
    assert np.corrcoef(predicted, returns_of(new, linear_truth))[0, 1] > 0.97


@pytest.fixture
def as_relevant(monkeypatch):
    """All entries stay as relevant as they are at first."""
    monkeypatch.setattr(module, "ROUNDS", 1)
    monkeypatch.setattr(module, "FEW", 0)
    jax.clear_caches()
    yield
    jax.clear_caches()


@pytest.mark.usefixtures("as_relevant")
def test_each_answer_makes_the_reward_surer_of_every_gap(T, gap):
    before = np.inf
    for n in range(1, len(PAIRS) + 1):
        reward = estimate_additive_reward(said(T, bent_truth, PAIRS[:n]), T, EXACT)
        scale = np.sqrt(float(reward.prior[1]))  # the overall scale is fitted anew each time: taken out
        sigma = np.array([gap(reward, T, i, j)[1] / scale for i, j in ((0, 5), (3, 9), (11, 2), (7, 8))])
        # float32 tells σ from the prior's only to a thousandth of it
        assert (sigma <= before + 2e-3 * np.abs(sigma).max() + 0.02).all()
        before = np.minimum(before, sigma)


def test_a_constant_reward_is_learned_from_the_lengths(uneven, gap):
    ones = lambda s, a: np.ones(len(s))
    reward = estimate_additive_reward(said(uneven, ones, PAIRS[:9]), uneven, AdditiveConfig())
    lengths = np.asarray(uneven.rows.length, float)
    for i, j in ((11, 10), (10, 0), (11, 3), (9, 10)):
        assert gap(reward, uneven, i, j)[0] == pytest.approx(lengths[i] - lengths[j], abs=1.5)
    rows = uneven.transitions()
    r = np.asarray(jax.vmap(reward)(rows.s, rows.a))[np.asarray(rows.mask)]
    assert r.mean() == pytest.approx(1, abs=0.15)


def test_where_lengths_are_equal_a_constant_cannot_be_told_and_is_left_out(T):
    reward = estimate_additive_reward(said(T, linear_truth), T, ONE)
    shifted = estimate_additive_reward(said(T, lambda s, a: linear_truth(s, a) + 4.0), T, ONE)
    assert float(reward.mean[0]) == 0
    np.testing.assert_allclose(shifted.returns(T)[:12], reward.returns(T)[:12], atol=1e-2)
    assert np.asarray(reward.returns(T))[:12].mean() == pytest.approx(0, abs=0.05)


@settings(max_examples=5)
@given(st.sampled_from([1e-3, 0.1, 7.0, 1e3]))
def test_the_judges_unit_is_the_unit_of_the_reward(T, gap, unit):
    one = estimate_additive_reward(said(T, bent_truth), T, ONE)
    other = estimate_additive_reward(said(T, lambda s, a: unit * bent_truth(s, a)), T, ONE)
    for i, j in ((3, 0), (8, 5)):
        np.testing.assert_allclose(gap(other, T, i, j), unit * np.array(gap(one, T, i, j)), rtol=3e-2)
    assert float(other.unit) == pytest.approx(unit * float(one.unit), rel=5e-3)


def test_swapping_a_pair_and_its_answer_changes_nothing(T):
    P = said(T, bent_truth)
    said_turned = dataclasses.replace(P.said, low=-P.g, high=-P.g)
    turned = dataclasses.replace(P, said=said_turned, clips=jax.tree.map(lambda x: x[:, ::-1], P.clips))
    one, other = (estimate_additive_reward(x, T, ONE).returns(T) for x in (P, turned))
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("truth", [linear_truth, bent_truth], ids=["linear", "bent"])
def test_marginal_likelihood_prefers_what_predicts_better(T, truth):
    new = linear_set(78, [H] * 11, H=H, capacity=N)
    true = np.array(returns_of(new, truth))

    def error(smooth):
        reward = estimate_additive_reward(
            said(T, truth), T, AdditiveConfig(smooth=smooth, lengths=(4.0,), noise=(1e-6,))
        )
        miss = np.asarray(reward.returns(new))[:11] - true
        chosen = float(reward.prior[1 + 2 * (p + q)] / reward.prior[1]) / spectrum(4.0)[0]
        return np.std(miss), chosen

    stiff, free, (both, chosen) = error((1e-3,))[0], error((1e3,))[0], error((1e-3, 1e3))
    assert chosen == pytest.approx(1e-3 if truth is linear_truth else 1e3, rel=1e-2)
    assert both == pytest.approx(min(stiff, free), rel=1e-3) and both < 0.9 * max(stiff, free)


def test_an_imagined_reward_stays_near_the_rewards_seen(T):
    reward = estimate_additive_reward(said(T, linear_truth), T, ONE)
    rows = T.transitions()
    seen = np.asarray(jax.vmap(reward)(rows.s, rows.a))[np.asarray(rows.mask)]
    width = seen.max() - seen.min()
    rng = np.random.default_rng(3)
    wild = jax.vmap(reward)(jnp.asarray(rng.normal(0, 99, (53, p)), jnp.float32), jnp.ones((53, q)))
    assert (
        np.asarray(wild).max() <= seen.max() + 0.2501 * width and np.asarray(wild).min() >= seen.min() - 0.2501 * width
    )


def test_many_steps_are_rewarded_as_one_is(T):
    reward = estimate_additive_reward(said(T, bent_truth), T, ONE)
    rng = np.random.default_rng(5)
    s, a = (
        jnp.asarray(rng.normal(0, 3, (3, 5, 2, p)), jnp.float32),
        jnp.asarray(rng.normal(size=(3, 5, 2, q)), jnp.float32),
    )

    @jax.jit
    def both(s, a):
        ways = (lambda s: reward.of_steps(s, a)), (lambda s: jnp.vectorize(reward, signature="(p),(q)->()")(s, a))
        return [(f(s), jax.grad(lambda s, f=f: jnp.sum(f(s) ** 2))(s)) for f in ways]

    (found, slope), (wanted, wanted_slope) = both(s, a)
    np.testing.assert_allclose(found, wanted, atol=1e-4 * float(jnp.max(jnp.abs(wanted))))
    np.testing.assert_allclose(slope, wanted_slope, atol=1e-3 * float(jnp.max(jnp.abs(wanted_slope))))


def test_what_was_only_imagined_sets_neither_the_range_nor_the_unit(T):
    dreams = jnp.arange(T.capacity) == PAIRS[-1][0]
    marked = eqx.tree_at(lambda T: T.rows.imagined, T, dreams)
    wild = eqx.tree_at(lambda T: T.rows.states, marked, jnp.where(dreams[:, None, None], 1e3, T.rows.states))
    P = said(T, linear_truth, PAIRS[:-1])  # nothing about it
    found, wanted = (estimate_additive_reward(P, T, AdditiveConfig()) for T in (wild, marked.executed()))
    for name in ("low", "high", "unit"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


def test_before_any_answer_nothing_is_expected(T, gap):
    reward = estimate_additive_reward(Preferences.empty(K), T, ONE)
    assert gap(reward, T, 3, 1)[0] == 0 and float(reward.unit) == 1
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(reward))


def test_trajectories_that_are_not_there_rank_last(T):
    returns = np.asarray(estimate_additive_reward(said(T, linear_truth), T, ONE).returns(T))
    assert np.isfinite(returns[:12]).all() and (returns[12:] == -np.inf).all()


def test_padding_changes_nothing(uneven):
    P = said(uneven, bent_truth)
    nan = jnp.where(P.filled, P.g, jnp.nan)
    spoilt = dataclasses.replace(P, said=dataclasses.replace(P.said, low=nan, high=nan))
    one, other = estimate_additive_reward(P, clean(uneven), ONE), estimate_additive_reward(spoilt, uneven, ONE)
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert np.isfinite(x).all()
        np.testing.assert_array_equal(x, y)


def wanderers(n, *, seed, far):
    """Trajectories of two entries that wander within 3 of the middle; of the last ones, the first goes as far as 15."""
    rng, taus = np.random.default_rng(seed), []
    for i in range(n):
        start, end = rng.uniform(-3, 3, (2, 2))
        if i >= n - far:
            end[0] = rng.uniform(10, 15)
        states = start + np.linspace(0, 1, 41)[:, None] * (end - start) + 0.1 * rng.normal(size=(41, 2))
        arrays = (jnp.asarray(x, jnp.float32) for x in (states, rng.uniform(-1, 1, (40, 1)), np.zeros(40)))
        taus.append(Trajectory(*arrays, jnp.asarray(40, jnp.int32), jnp.asarray(False)))
    return Trajectories(jax.tree.map(lambda *x: jnp.stack(x), *taus), jnp.asarray(n, jnp.int32))


@pytest.mark.parametrize(
    ("wanted", "left"), [(lambda x: -np.abs(x - 1), 5e-3), (lambda x: -((x - 1) ** 2), 5e-5)], ids=["post", "bowl"]
)
def test_what_is_wanted_near_by_is_found_beside_episodes_that_went_far(wanted, left):
    """A post to stand at is a kink, which needs fine functions where most values lie; a bowl is one from end to end."""

    def unexplained(seed):
        T, new = wanderers(24, seed=seed, far=6), wanderers(24, seed=seed + 100, far=0)
        paid = lambda T: wanted(np.asarray(T.rows.states[:, :-1, 0], float)).sum(axis=1)
        P = answers([(k + 1, k) for k in range(23)], np.diff(paid(T)), capacity=23)
        reward = estimate_additive_reward(P, T, AdditiveConfig())
        return 1 - np.corrcoef(np.asarray(reward.returns(new)), paid(new))[0, 1]

    assert np.mean([unexplained(seed) for seed in range(5)]) < left
