"""What an answer says of the utilities of the clips that were compared: one log likelihood for every kind of answer.

An answer about clips of utility v_1 … v_m speaks of their differences u_j = v_j - v_m only:

- `NUMBER`: u_1 is the number given, but for a Gaussian error.
- `LEVEL`: u_1, as a person perceives it, lies between two bounds. A choice is [0, ∞); "equal" is narrow around 0; one
  of five levels is its own fifth; "cannot tell" is (-∞, ∞), which says nothing.
- `RATING`: the same of one clip, against what was at hand.
- `RANKING`: the clips in this order, best first (Plackett-Luce).

Perception errs by a logistic variable of scale κ, and with two clips Plackett-Luce is the same as a choice.
Source: Bradley and Terry (1952); Plackett (1975), Luce (1959); ordered logit, McCullagh (1980).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hiprl.data.preference import Kind, Said
from hiprl.types import Count, Flag, Scalar

TINY = 1e-12
WIDE = 1e6  # in scales of the error: as good as infinite, and its gradient is a number
LEAST = 1e-30  # probability, so that its logarithm is a number


class Noise(eqx.Module):
    """How answers err."""

    kappa: Scalar
    """Scale of the logistic error of perception, in the unit of the levels."""
    var: Scalar
    """Variance of the error of a number, in the unit of u."""
    mistake: Float[Array, "..."]
    """Probability that a level was meant for the clips the other way round, or that a ranking means nothing: one for
    an answer, or one for each."""


def between(
    low: Float[Array, "..."], high: Float[Array, "..."], u: Float[Array, "..."], kappa: Scalar
) -> Float[Array, "..."]:
    """Log of the probability that u plus a logistic error of scale κ lies in [low, high]."""
    a, b = (jnp.clip((bound - u) / kappa, -WIDE, WIDE) for bound in (low, high))
    return both_sides(low, high, kappa) - jax.nn.softplus(-b) - jax.nn.softplus(a)


def both_sides(low: Float[Array, "..."], high: Float[Array, "..."], kappa: Scalar) -> Float[Array, "..."]:
    """What log (F(b) - F(a)) is besides log F(b) + log (1 - F(a)), for the logistic distribution F."""
    return jnp.log(-jnp.expm1(-jnp.clip((high - low) / kappa, TINY, WIDE)))


class Derivatives(NamedTuple):
    """A log likelihood, its slope in u, and minus its second derivative there."""

    value: Scalar
    slope: Float[Array, " J"]
    curvature: Float[Array, "J J"]


def plackett_luce(u: Float[Array, " J"], items: Count, kappa: Scalar) -> Derivatives:
    """Of the probability that the first `items` clips come in the order given; the last of them has utility 0.

    From the last place to the first: each is a choice between its clip and all that come after it, which are as good
    together as `rest`. What is chosen there is chosen as often before, where the clip of that place is not.

    Args:
        u: utility of each clip but the last over that of the last; what lies past `items` - 1 does not count.
        items: clips in the ranking.
        kappa: scale of the error of perception.
    """
    J = len(u)
    value = rest = jnp.zeros((), u.dtype)
    chosen = often = jnp.zeros_like(u)
    both = jnp.zeros((J, J), u.dtype)
    for j in reversed(range(J)):
        ranked = j < items - 1
        ahead = jnp.where(ranked, u[j] / kappa - rest, 0.0)
        share = jnp.where(ranked, jax.nn.sigmoid(ahead), 0.0)
        chosen = ((1 - share) * chosen).at[j].set(share)
        value -= jnp.where(ranked, jax.nn.softplus(-ahead), 0.0)
        rest += jnp.where(ranked, jax.nn.softplus(ahead), 0.0)
        often += chosen
        both += jnp.outer(chosen, chosen)
    free = jnp.arange(J) < items - 1
    return Derivatives(value, (free - often) / kappa, (jnp.diag(often) - both) / kappa**2)


def for_each(f: Callable[..., Any], u: Float[Array, "rows J"], said: Said, noise: Noise) -> Any:
    """`f` of each answer in a stack."""
    one = lambda u, said, mistake: f(u, said, Noise(noise.kappa, noise.var, mistake))
    return jax.vmap(one)(u, said, noise.mistake)


def levelled(said: Said) -> Flag:
    """Whether an answer is read as bounds on a perceived difference."""
    return (said.kind == Kind.LEVEL) | (said.kind == Kind.RATING)


def meant(u: Float[Array, " J"], said: Said, noise: Noise) -> Scalar:
    """Log likelihood of an answer that is no mistake."""
    is_level, is_ranking = levelled(said), said.kind == Kind.RANKING
    # what does not apply must stay finite, for the gradient's sake
    g = jnp.where(said.kind == Kind.NUMBER, said.low, 0.0)
    number = -0.5 * (u[0] - g) ** 2 / noise.var - 0.5 * jnp.log(2 * jnp.pi * noise.var)
    low, high = jnp.where(is_level, said.low, -1.0), jnp.where(is_level, said.high, 1.0)
    level = between(low, high, jnp.where(is_level, u[0], 0.0), noise.kappa)
    order = plackett_luce(jnp.where(is_ranking, u, 0.0), jnp.where(is_ranking, said.items, 1), noise.kappa)
    return jnp.where(is_ranking, order.value, jnp.where(is_level, level, number))


def mistaken(u: Float[Array, " J"], said: Said, noise: Noise) -> Scalar:
    """Log likelihood of an answer that is a mistake: a level for the wrong clip, any ranking at all."""
    is_level = levelled(said)
    low, high = jnp.where(is_level, said.low, -1.0), jnp.where(is_level, said.high, 1.0)
    level = between(low, high, jnp.where(is_level, -u[0], 0.0), noise.kappa)
    return jnp.where(is_level, level, -jax.lax.lgamma(said.items + 1.0))


def log_likelihood(u: Float[Array, " J"], said: Said, noise: Noise) -> Scalar:
    """Log likelihood of one answer, mistakes included. Numbers are never mistaken for others."""
    true, false = meant(u, said, noise), mistaken(u, said, noise)
    either = jnp.logaddexp(jnp.log1p(-noise.mistake) + true, jnp.log(jnp.maximum(noise.mistake, LEAST)) + false)
    return jnp.where(said.kind == Kind.NUMBER, true, either)


def responsibility(u: Float[Array, " J"], said: Said, noise: Noise) -> Scalar:
    """Probability that the answer was a mistake, given the utilities."""
    false = jnp.log(jnp.maximum(noise.mistake, LEAST)) + mistaken(u, said, noise)
    found = jnp.exp(false - log_likelihood(u, said, noise))
    return jnp.where(said.kind == Kind.NUMBER, 0.0, jnp.minimum(found, 1.0))


def ranking(u: Float[Array, " J"], said: Said, noise: Noise) -> Derivatives:
    """Of a ranking, mistakes included; the curvature is that of which explanation fits, and so never negative.

    With mistakes the likelihood is a mixture and need not be log-concave; what is meant is.
    """
    true = plackett_luce(u, said.items, noise.kappa)
    false = jnp.log(jnp.maximum(noise.mistake, LEAST)) - jax.lax.lgamma(said.items + 1.0)
    ahead = jnp.log1p(-noise.mistake) + true.value - false
    right = jax.nn.sigmoid(ahead)
    return Derivatives(false + jax.nn.softplus(ahead), right * true.slope, right * true.curvature)
