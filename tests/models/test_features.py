from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from hiprl.models.evidence import features_of
from hiprl.models.features import INSIDE, REACH, WAVES, Kernel, functions, parts_of, priors_of, spectrum, waves
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
    assert features.size == 1 + (p + q) * (1 + WAVES) == seen.shape[1]


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
    x = jnp.asarray(rng.uniform(-1.1 * REACH, 1.1 * REACH, 37), jnp.float32)
    weights = jnp.asarray(rng.normal(size=(1 + WAVES, 1)), jnp.float32)

    def by_waves(x):
        return jnp.sum(weights * jnp.stack([x, *waves(x)]), axis=0)

    slope = lambda f: jax.jit(jax.grad(lambda x: jnp.sum(jnp.cos(f(x)))))(x)
    np.testing.assert_allclose(functions(x, weights), by_waves(x), atol=1e-4)
    np.testing.assert_allclose(slope(partial(functions, weights=weights)), slope(by_waves), atol=1e-3)
    assert (np.abs(x) > INSIDE).any()


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
    np.testing.assert_allclose(prior[1 + n :].reshape(n, WAVES), np.tile(3 * spectrum(0.5), (n, 1)), rtol=1e-6)


def test_the_prior_of_each_kernel_is_the_sum_of_its_parts(features):
    kernels = AdditiveConfig().kernels
    parts, shares = parts_of(features, kernels)
    assert len(parts) < len(kernels)
    np.testing.assert_allclose(shares @ parts, priors_of(features, kernels), rtol=1e-6, atol=1e-6)
