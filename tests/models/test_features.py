from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from hiprl.models.evidence import features_of, most_of
from hiprl.models.features import (
    BOWED,
    INSIDE,
    OWN,
    REACH,
    SPAN,
    WAVES,
    Fine,
    Kernel,
    functions,
    parts_of,
    priors_of,
    spectrum,
    waves,
)
from hiprl.models.network import Scaler
from hiprl.models.reward import AdditiveConfig
from hiprl.models.sums import steps_of
from tests.data.samples import clean, p, q, seeds, set_of, trajectory


@pytest.fixture(scope="module")
def T():
    rng = np.random.default_rng(12)
    return set_of([trajectory(rng, length=n) for n in (7, 3, 5, 7, 1)])


@pytest.fixture(scope="module")
def features(T):
    return features_of(steps_of(T))


@pytest.fixture(scope="module")
def phi(features):
    return jax.jit(lambda s, a: features(s, a))


@pytest.mark.parametrize("length", [0.5, 1.0, 1.5])
def test_the_waves_reproduce_the_squared_exponential_kernel(length):
    x = np.linspace(-2.5, 2.5, 23)
    phi = np.stack(waves(jnp.asarray(x, jnp.float32)), axis=1)
    assert phi.shape == (23, WAVES)
    kernel = (phi * spectrum(length)) @ phi.T
    np.testing.assert_allclose(kernel, np.exp(-((x[:, None] - x) ** 2) / (2 * length**2)), atol=0.05)


def test_a_wave_is_a_sine_that_vanishes_where_the_reach_ends():
    x = np.linspace(-INSIDE, INSIDE, 41)
    found = np.stack(jax.jit(waves)(jnp.asarray(x, jnp.float32)), axis=1)
    j = np.arange(1, WAVES + 1)
    wanted = np.sin(np.pi * j * (x[:, None] + REACH) / (2 * REACH)) / np.sqrt(REACH)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_all_but_the_bias_have_mean_zero_over_what_was_seen(T, features):
    rows = T.transitions()
    seen = np.asarray(jax.vmap(features)(rows.s, rows.a))[np.asarray(rows.mask)]
    np.testing.assert_allclose(seen.mean(0), [1] + [0] * (features.size - 1), atol=1e-4)
    assert features.size == 1 + (p + q) * (OWN + WAVES) == seen.shape[1]


@given(seeds)
def test_past_the_box_a_coordinate_counts_as_its_edge(features, phi, seed):
    rng = np.random.default_rng(seed)
    s, a = jnp.asarray(rng.normal(0, 40, p), jnp.float32), jnp.asarray(rng.uniform(-1, 1, q), jnp.float32)
    edge = features.scaler.up(features.coordinates(s, a))
    np.testing.assert_allclose(phi(s, a), phi(edge[:p], edge[p:]), rtol=2e-3, atol=2e-3)
    assert np.isfinite(phi(s, a)).all()


@given(seeds)
def test_the_short_way_to_a_reward_is_the_long_way(features, phi, seed):
    rng = np.random.default_rng(seed)
    s, a = jnp.asarray(rng.normal(0, 3, p), jnp.float32), jnp.asarray(rng.uniform(-1, 1, q), jnp.float32)
    weights = jnp.asarray(rng.normal(size=features.size), jnp.float32)
    long = float(np.asarray(phi(s, a), float) @ np.asarray(weights, float))
    assert float(features.dot(s, a, weights)) == pytest.approx(long, rel=1e-3, abs=1e-3)


def test_a_function_has_the_slope_of_its_waves():
    rng = np.random.default_rng(2)
    fine = Fine(Scaler(jnp.asarray(0.3), jnp.asarray(0.7)), jnp.asarray(0.15))
    x = jnp.asarray(np.concatenate([rng.uniform(-2, 2, 30), rng.uniform(-200, 200, 30)]), jnp.float32)
    weights = jnp.asarray(rng.normal(size=(OWN + WAVES, 1)), jnp.float32)
    weights = weights.at[1].mul(1e-3)  # of x², which is large

    def by_waves(x):
        return jnp.sum(weights * jnp.stack([x, x**2, *waves(fine(x))]), axis=0)

    slope = lambda f: jax.jit(jax.grad(lambda x: jnp.sum(jnp.cos(f(x)))))(x)
    function = partial(functions, fine=fine, weights=weights)
    np.testing.assert_allclose(function(x), by_waves(x), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(slope(function), slope(by_waves), atol=1e-3)
    assert (np.abs(fine(x)) > INSIDE).any()


@pytest.mark.parametrize("far", [3.0, 20.0, 1000.0])
def test_all_that_was_seen_lies_within_the_span_and_the_middle_is_as_fine_as_ever(far):
    usual = Scaler(jnp.asarray([2.0]), jnp.asarray([0.5]))
    fine = Fine.of(usual, jnp.asarray([1.0]), jnp.asarray([2.0 + 0.5 * far]))
    x = jnp.linspace(1.0, 2.0 + 0.5 * far, 1001)
    wide = jax.tree.map(lambda x: jnp.broadcast_to(x, (1001,)), fine)
    z, rate = np.asarray(wide(x)), np.asarray(wide.slope(x))
    assert z.max() == pytest.approx(min(far, SPAN), rel=1e-4) and (np.diff(z) > 0).all()
    np.testing.assert_allclose(rate, jax.vmap(jax.grad(lambda x: fine(x[None])[0]))(x), rtol=1e-4)
    middle = np.abs(np.asarray(x) - 2) < 0.05
    np.testing.assert_allclose(rate[middle], 2, rtol=0.05)


def test_middle_and_spread_of_most_are_those_of_a_normal_distribution():
    rng = np.random.default_rng(4)
    x = rng.normal([[3.0], [-1.0]], [[2.0], [0.5]], (2, 20_000))
    usual = most_of(jnp.asarray(x, jnp.float32), jnp.ones(x.shape[1], bool))
    np.testing.assert_allclose(usual.mean, [3, -1], atol=0.05)
    np.testing.assert_allclose(usual.std, [2, 0.5], rtol=0.03)


def test_a_few_far_away_leave_middle_and_spread_as_they_are():
    rng = np.random.default_rng(5)
    x, there = rng.normal(size=(1, 4000)), np.arange(4000) < 3000
    x[:, :500] = rng.uniform(5, 10, 500)  # one in six
    x[:, 3000:] = np.inf
    usual = most_of(jnp.asarray(x / np.std(x[:, :3000]), jnp.float32), jnp.asarray(there))
    middle, spread = (np.asarray(y)[0] * np.std(x[:, :3000]) for y in (usual.mean, usual.std))
    assert abs(middle) < 0.4 and 0.8 < spread < 1.4 and np.std(x[:, :3000]) > 2.5


def test_an_entry_that_mostly_stands_still_keeps_its_other_values_apart():
    x = np.repeat([1.0, 0.5, -1.0], [90, 5, 5])
    x = (x - x.mean()) / x.std()
    usual = most_of(jnp.asarray(x[None], jnp.float32), jnp.ones(100, bool))
    fine = Fine.of(usual, *(jnp.asarray([edge], jnp.float32) for edge in (x.min(), x.max())))
    z = np.concatenate([fine(jnp.asarray([value], jnp.float32)) for value in x[[0, 90, 95]]])
    assert (np.diff(z) < -0.4).all()


def test_padding_changes_no_feature(T, features):
    for x, y in zip(jax.tree.leaves(features), jax.tree.leaves(features_of(steps_of(clean(T)))), strict=True):
        assert np.isfinite(x).all()
        np.testing.assert_array_equal(x, y)


def test_what_was_only_imagined_changes_no_feature(T, features):
    dreams = jnp.arange(T.capacity) % 3 == 1
    marked = eqx.tree_at(lambda T: T.rows.imagined, T, dreams)
    wild = eqx.tree_at(lambda T: T.rows.states, marked, jnp.where(dreams[:, None, None], 1e4, T.rows.states))
    with_dreams, without = (features_of(steps_of(T)) for T in (wild, marked.executed()))
    for x, y in zip(jax.tree.leaves(with_dreams), jax.tree.leaves(without), strict=True):
        np.testing.assert_array_equal(x, y)
    assert not np.array_equal(without.scaler.mean, features.scaler.mean)


def test_the_prior_is_as_wide_for_the_bias_as_for_all_the_rest(features):
    prior = np.asarray(features.prior(Kernel(3.0, 0.5)))
    n = p + q
    assert prior[0] == n * (1 + 3)
    np.testing.assert_array_equal(prior[1 : 1 + n], 1)
    np.testing.assert_allclose(prior[1 + n : 1 + 2 * n], 3 * BOWED, rtol=1e-6)
    np.testing.assert_allclose(prior[1 + 2 * n :].reshape(n, WAVES), np.tile(3 * spectrum(0.5), (n, 1)), rtol=1e-6)


def test_the_prior_of_each_kernel_is_the_sum_of_its_parts(features):
    kernels = AdditiveConfig().kernels
    parts, shares = parts_of(features, kernels)
    assert len(parts) < len(kernels)
    np.testing.assert_allclose(shares @ parts, priors_of(features, kernels), rtol=1e-6, atol=1e-6)
