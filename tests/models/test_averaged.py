"""Averages over a belief, against integrals on a fine grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from hiprl.data.answer import choice, level, number, ranking
from hiprl.models.averaged import averaged, beyond_gaussian, normal, probability
from hiprl.models.likelihood import Noise, for_each, log_likelihood, meant
from tests.models.test_variational import stacked

MEAN, VAR = [0.3, -0.2, 1.1, 0.6, -0.4], [0.7, 1.3, 4.0, 1e-4, 2.0]
TOLD = stacked([choice(True), level(1.0, 5), level(-2.0, 5), choice(False), ranking([0, 1])])
Z = np.linspace(-8, 8, 4001)
DENSITY = np.exp(-0.5 * Z**2) / np.sum(np.exp(-0.5 * Z**2))


def noise(kappa, mistake=0.0):
    return Noise(jnp.float32(kappa), jnp.float32(1e-2), jnp.full(5, mistake, jnp.float32))


def integrals(how, likelihood=log_likelihood):
    """Mean of value, slope and minus the second derivative of each log likelihood over its belief."""
    u = jnp.float32(np.asarray(MEAN)[:, None] + np.sqrt(VAR)[:, None] * Z)
    found = []
    for of in (likelihood, jax.grad(likelihood), lambda *given: -jax.hessian(likelihood)(*given)):
        each = jax.jit(jax.vmap(lambda u: for_each(of, u[:, None], TOLD, how)))(u.T)  # noqa: B023
        found.append(DENSITY @ np.asarray(each, float).reshape(len(Z), -1))
    return found


@pytest.mark.parametrize("kappa", [0.03, 0.1, 0.3])
def test_they_are_the_integrals(kappa):
    how = noise(kappa)
    found = averaged(jnp.float32(MEAN), jnp.float32(VAR), TOLD, how)
    for power, (mine, exact) in enumerate(zip(found, integrals(how, meant), strict=True)):
        np.testing.assert_allclose(mine, exact, rtol=5e-3, atol=1e-3 / kappa**power)


def test_with_mistakes_the_value_is_a_lower_bound_reached_by_who_is_sure():
    how = noise(0.1, mistake=0.05)
    exact = integrals(how)[0]
    found = np.asarray(averaged(jnp.float32(MEAN), jnp.float32(VAR), TOLD, how).value)
    assert (found < exact + 1e-2).all()
    assert found[3] == pytest.approx(exact[3], abs=0.02)  # of variance 1e-4


def test_a_number_is_read_exactly():
    told, how = stacked([number(0.5)]), Noise(jnp.float32(0.1), jnp.float32(0.04), jnp.full(1, 0.02))
    value, slope, bend = averaged(jnp.float32([0.2]), jnp.float32([0.3]), told, how)
    mean = stats.norm(0.5, 0.2).logpdf(0.2 + np.sqrt(0.3) * Z)
    assert float(value[0]) == pytest.approx(DENSITY @ mean, rel=1e-3)
    assert float(slope[0]) == pytest.approx(0.3 / 0.04, rel=1e-4)
    assert float(np.ravel(bend)[0]) == pytest.approx(25.0, rel=1e-4)
    assert float(beyond_gaussian(*map(jnp.float32, ([0.2], [0.3], [7.5], [2.5])), told, how)[0]) == 0


def test_bounds_that_are_infinite_say_that_anything_goes():
    one = lambda x: jnp.full(1, x, jnp.float32)
    likely = lambda mean, low: float(probability(one(mean), one(2.0), one(low), one(np.inf), jnp.float32(0.1))[0])
    assert likely(0.3, -np.inf) == pytest.approx(1, abs=1e-6)
    assert likely(0.0, 0.0) == pytest.approx(0.5, abs=1e-6)


def test_the_normal_distribution_is_right_to_seven_digits():
    z = np.linspace(-9, 9, 721)
    density, below = normal(jnp.float32(z))
    np.testing.assert_allclose(density, stats.norm.pdf(z), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(below, stats.norm.cdf(z), rtol=0, atol=2e-7)
