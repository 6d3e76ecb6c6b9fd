import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from hiprl.control.policy import ClippedPolicy, SquashedPolicy, Uniform, Value, log_normal
from hiprl.models.network import Scaler
from tests.data.samples import p, q, seeds

UNITS = Scaler(jnp.array([0.5, -1.0, 2.0]), jnp.array([0.7, 3.0, 1.5]))
OTHER = Scaler(jnp.array([-0.3, 1.0, 0.0]), jnp.array([2.0, 0.4, 1.1]))
NET = {"hidden": (7,), "activation": "elu"}


def scaled(policy, factor):
    return eqx.tree_at(lambda policy: policy.net.weights[-1], policy, factor * policy.net.weights[-1])


@pytest.fixture(scope="module")
def squashed():
    return scaled(SquashedPolicy.draw(UNITS, q, **NET, key=jr.key(4)), 60.0)


@pytest.fixture(scope="module")
def clipped():
    return scaled(ClippedPolicy.draw(UNITS, q, **NET, key=jr.key(4)), 150.0)


def some_state(seed):
    return jnp.asarray(np.random.default_rng(seed).normal(0, 2, p), jnp.float32)


@given(seeds)
def test_log_normal_is_scipys(seed):
    rng = np.random.default_rng(seed)
    u, mean, log_std = (jnp.asarray(rng.normal(size=q), jnp.float32) for _ in range(3))
    by_scipy = stats.norm.logpdf(np.asarray(u), np.asarray(mean), np.exp(np.asarray(log_std))).sum()
    assert float(log_normal(u, mean, log_std)) == pytest.approx(by_scipy, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_density_of_a_squashed_draw_is_that_after_the_change_of_variables(squashed, seed):
    s = some_state(seed)
    mean, log_std = (np.asarray(x, float) for x in squashed.gaussian(s))
    u, log_prob = squashed.with_log_prob(s, jr.normal(jr.key(seed), (q,)))
    inside = np.clip(np.asarray(u, float), -1 + 1e-9, 1 - 1e-9)
    by_scipy = stats.norm.logpdf(np.arctanh(inside), mean, np.exp(log_std)) - np.log1p(-(inside**2))
    assert float(log_prob) == pytest.approx(by_scipy.sum(), rel=1e-2, abs=1e-2)


def test_a_squashed_density_integrates_to_one(squashed):
    s = some_state(7)
    mean, log_std = (np.asarray(x, float)[0] for x in squashed.gaussian(s))

    def density(y):
        return np.exp(stats.norm.logpdf(np.arctanh(y), mean, np.exp(log_std)) - np.log1p(-(y**2)))

    total, _ = integrate.quad(density, -1, 1, points=[np.tanh(mean)])
    assert total == pytest.approx(1, abs=1e-3)


def test_the_mean_log_density_is_the_negative_entropy(squashed):
    # E[log p] by draws against the same by integration, summed over the entries
    s = some_state(3)
    _, log_prob = jax.vmap(lambda draw: squashed.with_log_prob(s, draw))(jr.normal(jr.key(9), (4001, q)))
    mean, log_std = (np.asarray(x, float) for x in squashed.gaussian(s))
    by_hand = 0.0
    for m, std in zip(mean, np.exp(log_std), strict=True):
        x, w = np.polynomial.hermite_e.hermegauss(101)
        u = m + std * x
        by_hand += (w / w.sum()) @ (stats.norm.logpdf(u, m, std) - 2 * (np.log(2) - u - np.logaddexp(0, -2 * u)))
    error = np.std(log_prob) / np.sqrt(4001)
    assert abs(float(np.mean(log_prob)) - by_hand) < 4 * error + 1e-3


@given(seeds, st.floats(-1e4, 1e4))
def test_no_action_leaves_the_box(squashed, clipped, seed, far):
    s = some_state(seed) + jnp.asarray(far, jnp.float32)
    for policy in (squashed, clipped):
        for u in (policy.mode(s), policy.sample(s, key=jr.key(seed))):
            assert u.shape == (q,) and np.isfinite(u).all() and (np.abs(u) <= 1).all()


def test_densities_stay_finite_at_the_edge(squashed):
    far = scaled(squashed, 1e4)
    draw = jnp.array([0.3, -1.7])
    u, log_prob = far.with_log_prob(some_state(1), draw)
    slope = jax.grad(lambda s: far.with_log_prob(s, draw)[1])(some_state(1))
    assert (np.abs(u) <= 1).all() and np.isfinite(log_prob) and np.isfinite(slope).all()


def test_as_drawn_a_policy_does_next_to_nothing():
    for kind in (SquashedPolicy, ClippedPolicy):
        policy = kind.draw(UNITS, q, **NET, key=jr.key(4))
        assert (np.abs(policy.mode(some_state(1))) < 0.1).all()


@given(seeds)
def test_other_units_leave_a_policy_as_it_was(squashed, clipped, seed):
    s = some_state(seed)
    for policy in (squashed, clipped):
        again = policy.rescaled(OTHER)
        np.testing.assert_array_equal(again.inputs.std, OTHER.std)
        np.testing.assert_allclose(again.mode(s), policy.mode(s), atol=2e-3)
        np.testing.assert_allclose(again.sample(s, key=jr.key(1)), policy.sample(s, key=jr.key(1)), atol=3e-3)


@given(seeds, st.floats(0.01, 100))
def test_other_units_leave_a_value_as_it_was(seed, scale):
    value = Value.draw(UNITS, **NET, key=jr.key(6))
    value = scaled(value, 100.0).rescaled(UNITS, jnp.asarray(3.0))
    s, again = some_state(seed), value.rescaled(OTHER, jnp.asarray(scale, jnp.float32))
    assert float(again.scale) == pytest.approx(scale)
    assert float(again(s)) == pytest.approx(float(value(s)), rel=2e-3, abs=2e-3)


def test_a_draw_inside_the_box_is_of_the_gaussian_that_is_said(clipped):
    s = some_state(2)
    mean, log_std = (np.asarray(x, float) for x in clipped.gaussian(s))
    drawn = np.asarray(jax.vmap(lambda key: clipped.sample(s, key=key))(jr.split(jr.key(3), 2999)))
    low, high = ((edge - mean) / np.exp(log_std) for edge in (-1.0, 1.0))
    for i in range(q):
        inside = drawn[np.abs(drawn[:, i]) < 1, i]
        assert len(inside) > 200
        z = (inside - mean[i]) / np.exp(log_std[i])
        assert 1e-4 < stats.kstest(z, "truncnorm", args=(low[i], high[i])).pvalue < 1 - 1e-4


def test_the_random_agent_is_uniform_in_a_box_of_its_size():
    agent = Uniform(jnp.asarray(0.6), q)
    a = np.asarray(jax.vmap(lambda key: agent.act(jnp.zeros(p), key=key))(jr.split(jr.key(5), 997)))
    for i in range(q):
        assert 1e-4 < stats.kstest(a[:, i], "uniform", args=(-0.6, 1.2)).pvalue < 1 - 1e-4
    assert abs(stats.pearsonr(a[:, 0], a[:, 1]).statistic) < 0.15


def test_random_agents_differ_in_their_effort():
    sizes = [float(Uniform.draw(q, key=key).size) for key in jr.split(jr.key(5), 97)]
    assert 1e-4 < stats.kstest(sizes, "uniform").pvalue < 1 - 1e-4
