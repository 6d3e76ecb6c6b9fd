from fractions import Fraction

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from hiprl.data.trajectory import Trajectory
from hiprl.models.calibration import MAX_BETA, MIN_BETA, Calibration, conformal_quantile, model_errors, rollout_errors
from hiprl.models.ensemble import Ensemble
from hiprl.models.network import Scaler
from hiprl.models.reward import Gap
from tests.data.samples import M, lengths, p, q, seeds, trajectory

HORIZONS = (1, 3, 5)


@pytest.fixture(scope="module")
def ensemble():
    rng = np.random.default_rng(8)
    inputs = Scaler(jnp.zeros(p + q), jnp.ones(p + q))
    steps = Scaler(jnp.asarray(rng.normal(size=p), jnp.float32), jnp.asarray(rng.uniform(0.3, 2, p), jnp.float32))
    return Ensemble.draw(inputs, steps, M=M, hidden=(7,), activation="tanh", key=jr.key(1))


@pytest.fixture(scope="module")
def scores():
    return jax.jit(model_errors)


@pytest.fixture(scope="module")
def predict(ensemble):
    compiled = jax.jit(lambda s, a: ensemble.predict(s, a))
    return lambda s, a: jax.tree.map(lambda x: np.asarray(x, float), compiled(jnp.asarray(s), jnp.asarray(a)))


@given(st.lists(st.floats(0, 1e3, width=32), min_size=1, max_size=59))
def test_the_quantile_is_the_one_of_split_conformal_prediction(x):
    n = len(x)
    padded = jnp.asarray(x + [0.0] * (59 - n), jnp.float32)
    rank = min(-(-(Fraction(9, 10) * (n + 1)).__ceil__() // 1), n)
    expected = np.sort(np.asarray(x, np.float32))[rank - 1]
    assert float(conformal_quantile(padded, jnp.asarray(n))) == expected


def test_the_quantile_does_not_see_what_lies_past_the_count():
    scores = jnp.array([3.0, 1.0, 2.0, jnp.nan, 1e9])
    assert float(conformal_quantile(scores, jnp.asarray(3))) == 3.0


@settings(max_examples=12)
@given(seeds, lengths)
def test_model_errors_are_those_of_a_plain_loop(ensemble, scores, predict, seed, n):
    tau = trajectory(np.random.default_rng(seed), length=n)
    states, actions = np.asarray(tau.states), np.asarray(tau.actions)
    error, noise, sigma = [], [], []
    for t in range(n):
        belief = predict(states[t], actions[t])
        error.append(states[t + 1] - belief.mu)
        noise.append(belief.noise)
        sigma.append(belief.sigma)
    error, noise, sigma = map(np.array, (error, noise, sigma))
    seen = scores(ensemble, tau)
    scale = np.asarray(ensemble.step_scale, float)
    assert float(seen.deviation) == pytest.approx(np.mean(np.sqrt((error**2).sum(1))), rel=1e-3)
    assert float(seen.relative) == pytest.approx(np.sqrt(np.mean((error / scale) ** 2)), rel=1e-3)
    inside = np.abs(error) <= stats.norm.ppf(0.95) * np.sqrt(sigma**2 + noise**2)
    assert float(seen.coverage) == pytest.approx(inside.mean(), abs=1.5 / (n * p))
    z = np.sort(np.sqrt(np.maximum(error**2 - noise**2, 0)) / sigma, axis=0)
    rank = min(int(np.ceil(0.9 * (n + 1) - 1e-9)), n)
    np.testing.assert_allclose(seen.beta, np.clip(z[rank - 1], MIN_BETA, MAX_BETA), rtol=2e-3)


@settings(max_examples=12)
@given(seeds, lengths)
def test_rollout_errors_are_those_of_a_plain_loop(ensemble, predict, seed, n):
    tau = trajectory(np.random.default_rng(seed), length=n)
    states, actions = np.asarray(tau.states), np.asarray(tau.actions)
    by_hand = {h: [] for h in HORIZONS}
    for t in range(n):
        s = states[t]
        for h in range(1, max(HORIZONS) + 1):
            if t + h > n:
                break
            s = np.asarray(predict(s, actions[t + h - 1]).mu, np.float32)
            if h in HORIZONS:
                by_hand[h].append(np.sqrt(((s - states[t + h]) ** 2).sum()))
    found = rollout_errors(ensemble, tau, HORIZONS)
    for h, x in zip(HORIZONS, found, strict=True):
        if n < h:
            assert np.isnan(x)
        else:
            assert float(x) == pytest.approx(np.mean(by_hand[h]), rel=1e-3)


def gaussian_errors(seed, *, truth_noise, sigma, n=211):
    """A trajectory whose steps differ from an ensemble's mean by Gaussian errors, and that ensemble.

    Its members stand still, but for shifts that give each dimension the spread `sigma`.
    """
    rng = np.random.default_rng(seed)
    shifts = rng.normal(size=(M, p))
    shifts = sigma * (shifts - shifts.mean(0)) / shifts.std(0, ddof=1)
    blank = Ensemble.draw(
        Scaler(jnp.zeros(p + q), jnp.ones(p + q)),
        Scaler(jnp.zeros(p), jnp.ones(p)),
        M=M,
        hidden=(),
        activation="tanh",
        key=jr.key(0),
    )
    log_var = 2 * np.log(0.5)
    bias = np.concatenate([shifts, np.full((M, p), log_var)], axis=1)
    net = (jnp.zeros_like(blank.stack.net.weights[0]), jnp.asarray(bias, jnp.float32))
    ensemble = eqx.tree_at(lambda e: (e.stack.net.weights[0], e.stack.net.biases[0]), blank, net)
    walk = np.concatenate([np.zeros((1, p)), np.cumsum(rng.normal(0, truth_noise, (n, p)), axis=0)])
    tau = Trajectory(
        states=jnp.asarray(walk, jnp.float32),
        actions=jnp.zeros((n, q)),
        rewards=jnp.zeros(n),
        length=jnp.asarray(n, jnp.int32),
        terminated=jnp.asarray(False),
    )
    return ensemble, tau


def test_coverage_is_nominal_where_errors_are_as_large_as_they_are_said_to_be(scores):
    # noise 0.5 and σ 0.3 together: errors of their root sum of squares
    ensemble, tau = gaussian_errors(3, truth_noise=np.hypot(0.5, 0.3), sigma=0.3)
    inside = round(float(scores(ensemble, tau).coverage) * 211 * p)
    assert 1e-4 < stats.binom.cdf(inside, 211 * p, 0.9) < 1 - 1e-4


def test_coverage_falls_where_the_model_is_too_sure_of_itself(scores):
    assert float(scores(*gaussian_errors(3, truth_noise=2.0, sigma=0.1)).coverage) < 0.5


def test_beta_is_small_where_errors_are_noise_and_large_where_they_are_not(scores):
    sure, unsure = (scores(*gaussian_errors(5, truth_noise=x, sigma=0.4)).beta for x in (0.1, 3.0))
    assert (np.asarray(sure) == np.float32(MIN_BETA)).all() and (np.asarray(unsure) == MAX_BETA).all()


def test_beta_covers_nine_tenths_of_the_errors_beyond_the_noise(scores):
    ensemble, tau = gaussian_errors(7, truth_noise=0.8, sigma=0.4)
    beta = np.asarray(scores(ensemble, tau).beta, float)
    error = np.diff(np.asarray(tau.states, float), axis=0)
    beyond = np.sqrt(np.maximum(error**2 - 0.25, 0))
    share = (beyond <= beta * 0.4 + 1e-4).mean(0)
    np.testing.assert_allclose(share, 0.9, atol=0.02)


def start(kappa=0.7):
    return Calibration.start(p, 11, kappa=kappa)


def test_alpha_is_the_conformal_quantile_of_the_errors_of_answers():
    rng, calibration, z = np.random.default_rng(2), start(), []
    assert float(calibration.alpha) == 1
    for _ in range(11):
        g, mean, sigma = rng.normal(0, 5), rng.normal(), rng.uniform(0.5, 2)
        z.append(abs(g - mean) / sigma)
        calibration = calibration.after_answer(jnp.asarray(g), Gap(jnp.asarray(mean), jnp.asarray(sigma)))
    rank = min(int(np.ceil(0.9 * 12)), 11)
    assert float(calibration.alpha) == pytest.approx(np.sort(z)[rank - 1], rel=1e-4)


def test_kappa_halves_when_imagination_promised_too_much(ensemble, scores):
    errors = scores(ensemble, trajectory(np.random.default_rng(1)))
    kept = start().after_episode(errors, decay=0.85, overpromised=jnp.asarray(False))
    broken = start().after_episode(errors, decay=0.85, overpromised=jnp.asarray(True))
    assert float(kept.kappa) == pytest.approx(0.7 * 0.85)
    assert float(broken.kappa) == pytest.approx(0.7 * 0.85 / 2)
    np.testing.assert_array_equal(kept.beta, errors.beta)
