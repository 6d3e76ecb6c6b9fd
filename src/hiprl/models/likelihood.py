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
from functools import partial
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


class Derivatives(NamedTuple):
    """A log likelihood, its slope in u, and minus its second derivative there."""

    value: Scalar
    slope: Float[Array, " J"]
    curvature: Float[Array, "J J"]


def between(
    low: Float[Array, "..."], high: Float[Array, "..."], u: Float[Array, "..."], kappa: Scalar
) -> Float[Array, "..."]:
    """Log of the probability that u plus a logistic error of scale κ lies in [low, high]."""
    a, b = (jnp.clip((bound - u) / kappa, -WIDE, WIDE) for bound in (low, high))
    return both_sides(low, high, kappa) - jax.nn.softplus(-b) - jax.nn.softplus(a)


def both_sides(low: Float[Array, "..."], high: Float[Array, "..."], kappa: Scalar) -> Float[Array, "..."]:
    """What log (F(b) - F(a)) is besides log F(b) + log (1 - F(a)), for the logistic distribution F."""
    return jnp.log(-jnp.expm1(-jnp.clip((high - low) / kappa, TINY, WIDE)))


def between_sides(
    low: Float[Array, "..."], high: Float[Array, "..."], u: Float[Array, "..."], kappa: Scalar
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Slope of `between` in u, and minus its second derivative."""
    a, b = (jax.nn.sigmoid(jnp.clip((bound - u) / kappa, -WIDE, WIDE)) for bound in (low, high))
    return (a - (1 - b)) / kappa, (a * (1 - a) + b * (1 - b)) / kappa**2


def plackett_luce(u: Float[Array, " J"], items: Count, kappa: Scalar) -> Derivatives:
    """Of the probability that the first `items` clips come in the order given; the last of them has utility 0.

    Args:
        u: utility of each clip but the last over that of the last; what lies past `items` - 1 does not count.
        items: clips in the ranking.
        kappa: scale of the error of perception.
    """
    j = jnp.arange(u.shape[0] + 1)
    ranked, free = j < items, (j < items - 1)[:-1]
    v = jnp.append(jnp.where(free, u, 0.0), 0.0) / kappa
    left = (j[None] >= j[:, None]) & ranked[None]  # to choose from, at each place
    rest = jax.nn.logsumexp(jnp.where(left | ~ranked[:, None], v[None], -jnp.inf), axis=1)
    chosen = jnp.where(left[:, :-1] & free[None], jnp.exp(v[None, :-1] - rest[:, None]), 0.0)
    often = jnp.sum(chosen, axis=0)
    value = jnp.sum(jnp.where(ranked, v - rest, 0.0))
    return Derivatives(value, (free - often) / kappa, (jnp.diag(often) - chosen.T @ chosen) / kappa**2)


def for_each(f: Callable[..., Any], u: Float[Array, "rows J"], said: Said, noise: Noise) -> Any:
    """`f` of each answer in a stack."""
    one = lambda u, said, mistake: f(u, said, Noise(noise.kappa, noise.var, mistake))
    return jax.vmap(one)(u, said, noise.mistake)


def levelled(said: Said) -> Flag:
    """Whether an answer is read as bounds on a perceived difference."""
    return (said.kind == Kind.LEVEL) | (said.kind == Kind.RATING)


def of_first(value: Scalar, slope: Scalar, curvature: Scalar, u: Float[Array, " J"]) -> Derivatives:
    """Of what hangs on u_1 alone."""
    slopes, curvatures = jnp.zeros_like(u), jnp.zeros((*u.shape, *u.shape), u.dtype)
    return Derivatives(value, slopes.at[0].set(slope), curvatures.at[0, 0].set(curvature))


def chosen_from(which: Flag, one: Derivatives, other: Derivatives) -> Derivatives:
    """One or the other."""
    return jax.tree.map(partial(jnp.where, which), one, other)


def a_level(u: Float[Array, " J"], said: Said, kappa: Scalar) -> Derivatives:
    """Of a level; finite where the answer is none."""
    is_level = levelled(said)
    low, high = jnp.where(is_level, said.low, -1.0), jnp.where(is_level, said.high, 1.0)
    first = jnp.where(is_level, u[0], 0.0)
    return of_first(between(low, high, first, kappa), *between_sides(low, high, first, kappa), u)


def meant(u: Float[Array, " J"], said: Said, noise: Noise) -> Derivatives:
    """Of an answer that is no mistake."""
    is_ranking = said.kind == Kind.RANKING
    # what does not apply must stay finite, for the gradient's sake
    error = jnp.where(said.kind == Kind.NUMBER, said.low, 0.0) - u[0]
    value = -0.5 * error**2 / noise.var - 0.5 * jnp.log(2 * jnp.pi * noise.var)
    number = of_first(value, error / noise.var, 1 / noise.var, u)
    ranking = plackett_luce(jnp.where(is_ranking, u, 0.0), jnp.where(is_ranking, said.items, 1), noise.kappa)
    level = a_level(u, said, noise.kappa)
    return chosen_from(is_ranking, ranking, chosen_from(levelled(said), level, number))


def mistaken(u: Float[Array, " J"], said: Said, noise: Noise) -> Derivatives:
    """Of an answer that is a mistake: a level for the wrong clip, any ranking at all."""
    turned = a_level(-u, said, noise.kappa)
    no_order = jax.tree.map(jnp.zeros_like, turned)._replace(value=-jax.lax.lgamma(said.items + 1.0).astype(u.dtype))
    return chosen_from(levelled(said), turned._replace(slope=-turned.slope), no_order)


def derivatives(u: Float[Array, " J"], said: Said, noise: Noise) -> Derivatives:
    """Of one answer, mistakes included; the curvature is that of which explanation fits, and so never negative.

    With mistakes the likelihood is a mixture and need not be log-concave; each of its two parts is.
    """
    true, false, wrong = meant(u, said, noise), mistaken(u, said, noise), responsibility(u, said, noise)
    mixed = lambda x, y: (1 - wrong) * x + wrong * y
    return jax.tree.map(mixed, true, false)._replace(value=log_likelihood(u, said, noise))


def log_likelihood(u: Float[Array, " J"], said: Said, noise: Noise) -> Scalar:
    """Log likelihood of one answer, mistakes included. Numbers are never mistaken for others."""
    true, false = meant(u, said, noise).value, mistaken(u, said, noise).value
    either = jnp.logaddexp(jnp.log1p(-noise.mistake) + true, jnp.log(jnp.maximum(noise.mistake, LEAST)) + false)
    return jnp.where(said.kind == Kind.NUMBER, true, either)


def responsibility(u: Float[Array, " J"], said: Said, noise: Noise) -> Scalar:
    """Probability that the answer was a mistake, given the utilities."""
    false = jnp.log(jnp.maximum(noise.mistake, LEAST)) + mistaken(u, said, noise).value
    found = jnp.exp(false - log_likelihood(u, said, noise))
    return jnp.where(said.kind == Kind.NUMBER, 0.0, jnp.minimum(found, 1.0))
