import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings

from hiprl.models.ensemble import MAX_LOG_VAR, MIN_LOG_VAR, Ensemble, Member, bounded_var
from hiprl.models.network import Scaler
from tests.data.samples import M, p, q, seeds


@pytest.fixture(scope="module")
def ensemble():
    rng = np.random.default_rng(3)

    def units(n):
        return Scaler(jnp.asarray(rng.normal(size=n), jnp.float32), jnp.asarray(rng.uniform(0.3, 3, n), jnp.float32))

    return Ensemble.draw(units(p + q), units(p), M=M, hidden=(7,), activation="silu", key=jr.key(5))


@pytest.fixture(scope="module")
def predictions(ensemble):
    """Of all members and of the ensemble, compiled."""

    @jax.jit
    def compiled(s, a):
        each = jax.vmap(Member.predict, in_axes=(0, None, None))(ensemble.stack, s, a)
        return each, ensemble.predict(s, a)

    return compiled


def draw(seed):
    rng = np.random.default_rng(seed)
    return jnp.asarray(rng.normal(0, 2, p), jnp.float32), jnp.asarray(rng.uniform(-1, 1, q), jnp.float32)


@given(seeds)
def test_sigma_is_the_spread_of_the_members_means(predictions, seed):
    each, belief = predictions(*draw(seed))
    np.testing.assert_allclose(belief.mu, np.mean(each.mu, axis=0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(belief.sigma, np.std(np.asarray(each.mu, float), axis=0, ddof=1), rtol=1e-3, atol=1e-5)


@settings(max_examples=12)
@given(seeds)
def test_noise_is_the_members_noise_and_no_part_of_sigma(ensemble, predictions, seed):
    s, a = draw(seed)
    each, belief = predictions(s, a)
    np.testing.assert_allclose(belief.noise, np.sqrt(np.mean(np.asarray(each.noise, float) ** 2, axis=0)), rtol=1e-4)
    # members that are ten times as noisy leave σ where it was
    louder = jax.tree.map(lambda x: x, ensemble)
    last = louder.stack.net.biases[-1].at[:, p:].add(3.0)
    louder = Ensemble(with_last_bias(louder.stack, last))
    other = louder.predict(s, a)
    np.testing.assert_allclose(other.sigma, belief.sigma, rtol=1e-4, atol=1e-6)
    assert (np.asarray(other.noise) > np.asarray(belief.noise)).all()


def with_last_bias(stack, bias):
    return eqx.tree_at(lambda stack: stack.net.biases[-1], stack, bias)


def test_a_member_is_sure_of_itself(ensemble):
    s, a = draw(1)
    members = ensemble.members()
    for i in range(M):
        one = jax.tree.map(lambda x, i=i: x[i], members)
        assert (np.asarray(one.predict(s, a).sigma) == 0).all()
        assert jax.tree.leaves(one.members())[0].shape[0] == 1


@settings(max_examples=12)
@given(seeds)
def test_other_units_inside_leave_the_means_as_they_were(ensemble, seed):
    rng = np.random.default_rng(seed)
    inputs, steps = (
        Scaler(jnp.asarray(rng.normal(size=n), jnp.float32), jnp.asarray(rng.uniform(0.3, 3, n), jnp.float32))
        for n in (p + q, p)
    )
    member = jax.tree.map(lambda x: x[2], ensemble.stack)
    s, a = draw(seed)
    np.testing.assert_allclose(
        member.rescaled(inputs, steps).predict(s, a).mu, member.predict(s, a).mu, rtol=1e-3, atol=1e-3
    )


def softly(raw):
    """A log variance between its bounds, by one softplus from each of them."""
    upper = MAX_LOG_VAR - np.logaddexp(0, MAX_LOG_VAR - raw)
    return MIN_LOG_VAR + np.logaddexp(0, upper - MIN_LOG_VAR)


def test_variances_stay_between_their_bounds_and_keep_a_slope():
    raw = np.linspace(-90, 90, 61)
    var = np.asarray(bounded_var(jnp.asarray(raw, jnp.float32)), float)
    np.testing.assert_allclose(np.log(var), softly(raw), atol=1e-3)
    assert (np.diff(np.log(var)) > -1e-5).all()
    slope = jax.vmap(jax.grad(lambda x: jnp.log(bounded_var(x[None])[0])))(jnp.array([-12.0, -4.0, 3.0]))
    assert (np.asarray(slope) > 0.01).all()


def test_sigma_has_a_gradient_where_members_agree(ensemble):
    first = jax.tree.map(lambda x: jnp.broadcast_to(x[:1], x.shape), ensemble)
    s, a = draw(2)
    slope = jax.grad(lambda s: jnp.sum(first.predict(s, a).sigma))(s)
    assert np.isfinite(slope).all()
    assert (np.asarray(first.predict(s, a).sigma) < 1e-4).all()
