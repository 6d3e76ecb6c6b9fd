"""What answers about one difference say on average over a Gaussian belief about it, in closed form.

A logistic error is, but for 1.1e-4 in its distribution function and in that function's derivative and integral, a
mixture of three Gaussians. Convolved with the belief it stays one, so that no average needs quadrature: which few nodes
would get wrong where a belief is wide and the judge exact. Whether an answer was a mistake is believed by itself.
Source: Monahan and Stefanski (1992) for the mixture; Opper, Paquet and Winther (2013) for
`beyond_gaussian`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Float

from hiprl.data.preference import Kind, Said
from hiprl.models.likelihood import LEAST, WIDE, Noise, both_sides
from hiprl.types import Scalar

WEIGHTS = (0.24183954, 0.59642101, 0.16173945)
SCALES = (1.09213588, 1.72198554, 2.76084677)
"""Weight and standard deviation of each part of the mixture."""
MOST = 0.5  # nats that a Gaussian misses of an answer; more would be a second explanation, told anew by each answer


class Averaged(NamedTuple):
    """Mean over the belief of log likelihoods, of their slope, and of minus their second derivative."""

    value: Float[Array, " rows"]
    slope: Float[Array, " rows"]
    curvature: Float[Array, " rows"]


Rows = Float[Array, " rows"]
Ways = Float[Array, "2 rows"]
"""Of the clips as they were shown, and the other way round."""


def averaged(mean: Rows, var: Rows, said: Said, noise: Noise) -> Averaged:
    """Of answers about u ~ N(mean, var) each, mistakes included; `items` is at most 2.

    With mistakes it is a lower bound of the mean, reached where what was meant does not hang on u.
    """
    ranking, alone = said.kind == Kind.RANKING, nothing_said(said)
    level = of_level(either_way(mean), var, *bounds(said), noise.kappa)
    meant, (value, slope, curvature) = (jax.tree.map(lambda x: x[way], level) for way in (0, 1))  # noqa: B023
    meant = jax.tree.map(lambda x: jnp.where(alone, 0.0, x), meant)
    no_order = Averaged(-jax.lax.lgamma(said.items + 1.0).astype(mean.dtype), jnp.zeros(()), jnp.zeros(()))
    mistaken = jax.tree.map(lambda x, y: jnp.where(ranking, x, y), no_order, Averaged(value, -slope, curvature))
    right = jnp.log1p(-noise.mistake) + meant.value
    wrong = jnp.log(jnp.maximum(noise.mistake, LEAST)) + mistaken.value
    share = jax.nn.sigmoid(wrong - right)
    mixed = lambda x, y: (1 - share) * x + share * y
    either = Averaged(
        jnp.logaddexp(right, wrong), mixed(meant.slope, mistaken.slope), mixed(meant.curvature, mistaken.curvature)
    )
    number = said.kind == Kind.NUMBER
    error = jnp.where(number, said.low, 0.0) - mean
    exact = Averaged(
        -0.5 * (error**2 + var) / noise.var - 0.5 * jnp.log(2 * jnp.pi * noise.var), error / noise.var, 1 / noise.var
    )
    return jax.tree.map(lambda x, y: jnp.where(number, x, y), exact, either)


def beyond_gaussian(mean: Rows, var: Rows, slope: Rows, curvature: Rows, said: Said, noise: Noise) -> Rows:
    """By how much the log of the mean of each likelihood exceeds `averaged`, but for what a Gaussian has of it.

    That is the likelihood over the Gaussian that the belief has in its place, averaged over the belief: 0 for a number.

    Args:
        mean: of the belief about u.
        var: its variance.
        slope: of the log of that Gaussian at the mean.
        curvature: minus the second derivative of that logarithm; less than 1 / var.
        said: the answers.
        noise: how they err.
    """
    left = jnp.maximum(1 - curvature * var, LEAST)
    cavity = var / left  # the belief without this answer
    middle = mean - slope * cavity
    meant, turned = probability(either_way(middle), cavity, *bounds(said), noise.kappa)
    meant = jnp.where(nothing_said(said), 1.0, meant)
    no_order = jnp.exp(-jax.lax.lgamma(said.items + 1.0)).astype(mean.dtype)
    mistaken = jnp.where(said.kind == Kind.RANKING, no_order, turned)
    likely = (1 - noise.mistake) * meant + noise.mistake * mistaken
    value = averaged(mean, var, said, noise).value
    rest = jnp.log(jnp.maximum(likely, LEAST)) - value + 0.5 * (slope**2 * cavity - curvature * var - jnp.log(left))
    counted = (said.kind != Kind.NUMBER) & (likely > LEAST)  # else nothing is known of its logarithm
    return jnp.where(counted, jnp.clip(rest, 0.0, MOST), 0.0)


def either_way(mean: Rows) -> Ways:
    """Mean of u, and of what it is of the clips the other way round."""
    return jnp.stack([mean, -mean])


def bounds(said: Said) -> tuple[Rows, Rows]:
    """Of the perceived difference; a ranking of two is a choice."""
    number, ranking = said.kind == Kind.NUMBER, said.kind == Kind.RANKING
    low = jnp.where(ranking, 0.0, jnp.where(number, -1.0, said.low))  # what does not apply must stay finite
    return low, jnp.where(ranking, jnp.inf, jnp.where(number, 1.0, said.high))


def nothing_said(said: Said) -> Array:
    """A ranking of a single clip."""
    return (said.kind == Kind.RANKING) & (said.items < 2)


def of_level(mean: Ways, var: Rows, low: Rows, high: Rows, kappa: Scalar) -> Averaged:
    """Of answers that u, perceived with a logistic error of scale κ, lies in [low, high].

    They are log F((high - u) / κ) + log F((u - low) / κ) for the logistic distribution F, and a constant. All bounds
    and parts of the mixture are one array: a normal distribution function takes long to compile.
    """
    weight, std = parts(var, kappa)
    over = jnp.stack([mean - high[None], low[None] - mean])  # by how much u exceeds each bound
    z = jnp.clip(over[None] / std, -WIDE, WIDE)
    density, below = norm.pdf(z), norm.cdf(z)
    of_each = -std * (density + z * below), -below, density / std
    value, slope, curvature = (jnp.sum(weight * x, axis=0) / kappa for x in of_each)
    constant = both_sides(low, high, kappa)
    return Averaged(constant[None] + value[0] + value[1], slope[0] - slope[1], curvature[0] + curvature[1])


def probability(mean: Ways, var: Rows, low: Rows, high: Rows, kappa: Scalar) -> Ways:
    """Mean of the likelihood of a level."""
    weight, std = parts(var, kappa)
    below = norm.cdf(jnp.stack([high[None] - mean, low[None] - mean])[None] / std)
    return jnp.sum(weight * (below[:, :1] - below[:, 1:]), axis=0)[0]


def parts(var: Rows, kappa: Scalar) -> tuple[Float[Array, "3 1 1 1"], Float[Array, "3 1 1 rows"]]:
    """Weight of each part of a perceived u, and its standard deviation."""
    weight, scale = (jnp.asarray(x, var.dtype)[:, None, None, None] for x in (WEIGHTS, SCALES))
    return weight, jnp.sqrt(var[None, None, None] + (kappa * scale) ** 2)
