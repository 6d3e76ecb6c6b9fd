import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy import stats

from hiprl.models.dynamics import (
    LEAST,
    SPREAD,
    DynamicsConfig,
    estimate_dynamics,
    new_dynamics,
    nll,
    no_louder_than_its_errors,
    one_cycle,
)
from tests.data.samples import clean, p, q
from tests.models.worlds import NOISE, A, B, linear_set

CONFIG = DynamicsConfig(M=3, hidden=(32,), cold_steps=1000, warm_steps=100, batch=64)
H, LENGTHS = 31, (31, 17, 31, 5, 31, 31, 23, 31, 31, 31, 31, 29, 31, 31, 31, 31, 31)


@pytest.fixture(scope="module")
def T():
    return linear_set(1, LENGTHS, H=H)


def fitted(T, *, steps=CONFIG.cold_steps, before=None, config=CONFIG):
    before = new_dynamics(T, config, key=jr.key(2)) if before is None else before
    return estimate_dynamics(T, before, config, steps=steps, key=jr.key(3))


@pytest.fixture(scope="module")
def learned(T):
    return fitted(T)


@pytest.fixture(scope="module")
def test_rows():
    """Steps of the same world that no model has seen."""
    rows = linear_set(99, (31, 31, 31), H=H).transitions()
    seen = np.asarray(rows.mask)
    return jnp.asarray(np.asarray(rows.s)[seen]), jnp.asarray(np.asarray(rows.a)[seen])


def beliefs(state, s, a):
    return jax.tree.map(np.asarray, jax.vmap(state.ensemble.predict)(s, a))


def error_of(state, s, a):
    """Root mean square error of μ, over the spread of a step."""
    truth = np.asarray(s) @ A.T + np.asarray(a) @ B.T
    step = (truth - np.asarray(s)).std(0)
    return np.sqrt(np.mean(((beliefs(state, s, a).mu - truth) / step) ** 2))


def test_the_likelihood_is_that_of_a_gaussian_in_every_dimension(learned):
    member = jax.tree.map(lambda x: x[1], learned[0].ensemble.stack)
    rng = np.random.default_rng(4)
    for _ in range(5):
        s, a, step = (jnp.asarray(rng.normal(size=n), jnp.float32) for n in (p, q, p))
        mean, var = (np.asarray(x, float) for x in member.standardised(s, a))
        by_scipy = -stats.norm.logpdf(np.asarray(step, float), mean, np.sqrt(var)).sum()
        constant = 0.5 * p * np.log(2 * np.pi)
        assert float(nll(member, s, a, step)) == pytest.approx(by_scipy - constant, rel=1e-4, abs=1e-4)


def test_a_fitted_model_is_near_the_truth_where_it_has_data(T, learned, test_rows):
    before = error_of(new_dynamics(T, CONFIG, key=jr.key(2)), *test_rows)
    assert error_of(learned[0], *test_rows) < 0.25 < before


def test_the_noise_is_that_of_the_world(learned, test_rows):
    noise = np.median(beliefs(learned[0], *test_rows).noise, axis=0)
    assert (noise > 0.5 * NOISE).all() and (noise < 2.5 * NOISE).all()


def test_a_member_that_expects_larger_errors_than_it_makes_is_made_as_quiet_as_they_are(learned, test_rows):
    member, (s, a) = jax.tree.map(lambda x: x[0], learned[0].ensemble.stack), test_rows
    mean, var = jax.vmap(member.standardised)(s, a)
    share = np.array([0.04, 0.36, 9.0])  # of the variance: nothing is made louder
    error = np.sqrt(share * np.asarray(var)) * np.sign(np.random.default_rng(5).normal(size=mean.shape))
    quiet = no_louder_than_its_errors(member, s, a, mean + jnp.asarray(error, jnp.float32))
    mean_then, var_then = jax.vmap(quiet.standardised)(s, a)
    np.testing.assert_array_equal(mean_then, mean)
    np.testing.assert_allclose(var_then.mean(0) / var.mean(0), np.minimum(share, 1.0), rtol=0.1)


def test_a_member_without_errors_keeps_a_little_noise_from_which_it_can_learn(learned, test_rows):
    member, (s, a) = jax.tree.map(lambda x: x[0], learned[0].ensemble.stack), test_rows
    mean, var = jax.vmap(member.standardised)(s, a)
    _, var_then = jax.vmap(no_louder_than_its_errors(member, s, a, mean).standardised)(s, a)
    assert (var_then >= 0.9 * LEAST * var).all() and (var_then < 0.1 * var).all()


def test_sigma_is_larger_far_from_the_data(learned, test_rows):
    s, a = test_rows
    near, far = beliefs(learned[0], s, a).sigma, beliefs(learned[0], 10 * s, a).sigma
    assert np.median(far) > 3 * np.median(near)


def test_padding_and_unfilled_rows_change_nothing(T, learned):
    again, _ = fitted(clean(T))
    for x, y in zip(jax.tree.leaves(learned[0]), jax.tree.leaves(again), strict=True):
        assert np.isfinite(x).all()
        np.testing.assert_array_equal(x, y)


def test_a_refit_goes_on_from_the_weights_there_are(T, learned, test_rows):
    cold, _ = fitted(T, steps=CONFIG.warm_steps)
    warm, _ = fitted(T, steps=CONFIG.warm_steps, before=learned[0])
    assert error_of(warm, *test_rows) < 0.8 * error_of(cold, *test_rows)
    np.testing.assert_array_equal(warm.bootstrap, learned[0].bootstrap)


def test_where_t_has_spread_to_far_more_nothing_is_left_of_the_weights_there_were(T, learned):
    narrow, _ = learned
    wide = eqx.tree_at(lambda T: T.rows.states, T, T.rows.states * (1.1 * SPREAD))
    other = eqx.tree_at(
        lambda d: d.ensemble.stack.net.weights, narrow, jax.tree.map(lambda w: w + 1, narrow.ensemble.stack.net.weights)
    )
    one, report = fitted(wide, steps=CONFIG.warm_steps, before=narrow)
    another, _ = fitted(wide, steps=CONFIG.warm_steps, before=other)
    assert int(report.steps) == CONFIG.cold_steps > CONFIG.warm_steps
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(another), strict=True):
        np.testing.assert_array_equal(x, y)


def test_as_many_steps_as_asked_for_are_taken(T, learned):
    assert int(learned[1].steps) == CONFIG.cold_steps
    _, report = fitted(T, steps=CONFIG.warm_steps)
    assert int(report.steps) == CONFIG.warm_steps


def test_members_differ_and_so_do_their_data(learned):
    s, a = jnp.ones(p), jnp.full(q, 0.5)
    mu = [np.asarray(jax.tree.map(lambda x, i=i: x[i], learned[0].ensemble.stack).predict(s, a).mu) for i in range(3)]
    assert all((mu[i] != mu[j]).any() for i, j in ((0, 1), (0, 2), (1, 2)))


def test_the_scalers_are_measured_and_not_trained(T, learned):
    rows = T.transitions()
    seen = np.asarray(rows.mask)
    steps = (np.asarray(rows.s_next) - np.asarray(rows.s))[seen]
    stack = learned[0].ensemble.stack
    for i in range(CONFIG.M):
        np.testing.assert_allclose(np.asarray(stack.steps.mean)[i], steps.mean(0), atol=1e-4)
        np.testing.assert_allclose(np.asarray(stack.steps.std)[i], steps.std(0), rtol=1e-3)
    np.testing.assert_allclose(learned[0].ensemble.step_scale, steps.std(0), rtol=1e-3)


def test_a_single_trajectory_is_enough_to_fit():
    state, report = fitted(linear_set(5, (3,), H=H, capacity=len(LENGTHS) + 2))
    assert np.isfinite(report.loss) and all(np.isfinite(x).all() for x in jax.tree.leaves(state.ensemble))


def test_the_rate_rises_for_a_tenth_and_falls_to_nothing():
    rates = np.array([one_cycle(0.3, jnp.asarray(200), jnp.asarray(now)) for now in range(201)])
    assert rates[0] == pytest.approx(0.03) and rates[20] == rates.max() == pytest.approx(0.3)
    assert (np.diff(rates[:21]) > 0).all() and (np.diff(rates[20:]) < 0).all()
    assert rates[-1] == pytest.approx(0, abs=1e-6)


def test_long_and_short_fits_are_one_program(T, learned):
    before = estimate_dynamics._cache_size()
    _, report = fitted(T, steps=CONFIG.warm_steps, before=learned[0])
    assert int(report.steps) == CONFIG.warm_steps
    assert estimate_dynamics._cache_size() == before


def test_few_coordinates_get_smaller_networks_unless_the_config_says_otherwise(T):
    built = lambda config: [b.shape[1] for b in new_dynamics(T, config, key=jr.key(1)).ensemble.stack.net.biases[:-1]]
    assert built(DynamicsConfig()) == [64, 64] and built(DynamicsConfig(hidden=(7,))) == [7]
    assert DynamicsConfig().layers(8) == (64, 64) and DynamicsConfig().layers(9) == (128, 128, 128)
    assert DynamicsConfig(hidden=()).layers(9) == ()
