"""What answers about one difference say on average over a Gaussian belief about it, in closed form.

A logistic error is, but for 1.1e-4 in its distribution function and in that function's derivative and integral, a
mixture of three Gaussians. Convolved with the belief it stays one, so that no average needs quadrature: which few nodes
would get wrong where a belief is wide and the judge exact. Whether an answer was a mistake is believed by itself.
Source: Monahan and Stefanski (1992) for the mixture; Opper, Paquet and Winther (2013) for
`beyond_gaussian`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
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


def averaged(mean: Rows, var: Rows, said: Said, noise: Noise) -> Averaged:
    """Of answers about u ~ N(mean, var) each, mistakes included; `items` is at most 2.

    With mistakes it is a lower bound of the mean, reached where what was meant does not hang on u.
    """
    low, high = bounds(said)
    meant, turned = level(mean, var, low, high, noise.kappa), level(-mean, var, low, high, noise.kappa)
    ranking, alone = said.kind == Kind.RANKING, nothing_said(said)
    meant = jax.tree.map(lambda x: jnp.where(alone, 0.0, x), meant)
    no_order = Averaged(-jax.lax.lgamma(said.items + 1.0).astype(mean.dtype), jnp.zeros(()), jnp.zeros(()))
    mistaken = Averaged(turned.value, -turned.slope, turned.curvature)
    mistaken = jax.tree.map(lambda x, y: jnp.where(ranking, x, y), no_order, mistaken)
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
    low, high = bounds(said)
    meant = jnp.where(nothing_said(said), 1.0, probability(middle, cavity, low, high, noise.kappa))
    turned = probability(-middle, cavity, low, high, noise.kappa)
    no_order = jnp.exp(-jax.lax.lgamma(said.items + 1.0)).astype(mean.dtype)
    mistaken = jnp.where(said.kind == Kind.RANKING, no_order, turned)
    likely = (1 - noise.mistake) * meant + noise.mistake * mistaken
    value = averaged(mean, var, said, noise).value
    rest = jnp.log(jnp.maximum(likely, LEAST)) - value + 0.5 * (slope**2 * cavity - curvature * var - jnp.log(left))
    counted = (said.kind != Kind.NUMBER) & (likely > LEAST)  # else nothing is known of its logarithm
    return jnp.where(counted, jnp.clip(rest, 0.0, MOST), 0.0)


def bounds(said: Said) -> tuple[Rows, Rows]:
    """Of the perceived difference; a ranking of two is a choice."""
    number, ranking = said.kind == Kind.NUMBER, said.kind == Kind.RANKING
    low = jnp.where(ranking, 0.0, jnp.where(number, -1.0, said.low))  # what does not apply must stay finite
    return low, jnp.where(ranking, jnp.inf, jnp.where(number, 1.0, said.high))


def nothing_said(said: Said) -> Array:
    """A ranking of a single clip."""
    return (said.kind == Kind.RANKING) & (said.items < 2)


def level(mean: Rows, var: Rows, low: Rows, high: Rows, kappa: Scalar) -> Averaged:
    """Of answers that u, perceived with a logistic error of scale κ, lies in [low, high]."""
    above, below = at_most(mean, var, high, kappa), at_most(-mean, var, -low, kappa)
    value = both_sides(low, high, kappa) + above.value + below.value
    return Averaged(value, above.slope - below.slope, above.curvature + below.curvature)


def at_most(mean: Rows, var: Rows, high: Rows, kappa: Scalar) -> Averaged:
    """Of answers that u is perceived as at most so large: of log F((high - u) / κ) for the logistic distribution F."""
    total = jax.tree.map(jnp.zeros_like, Averaged(mean, mean, mean))
    for weight, scale in zip(WEIGHTS, SCALES, strict=True):
        std = jnp.sqrt(var + (kappa * scale) ** 2)
        z = jnp.clip((mean - high) / std, -WIDE, WIDE)
        density, below = normal(z)
        part = Averaged(-std * (density + z * below), -below, density / std)
        total = jax.tree.map(lambda x, y: x + weight * y / kappa, total, part)  # noqa: B023
    return total


def probability(mean: Rows, var: Rows, low: Rows, high: Rows, kappa: Scalar) -> Rows:
    """Mean of the likelihood of a level."""
    total = jnp.zeros_like(mean)
    for weight, scale in zip(WEIGHTS, SCALES, strict=True):
        std = jnp.sqrt(var + (kappa * scale) ** 2)
        a, b = (jnp.clip((bound - mean) / std, -WIDE, WIDE) for bound in (low, high))
        total += weight * (normal(b)[1] - normal(a)[1])
    return total


def normal(z: Rows) -> tuple[Rows, Rows]:
    """Density and distribution function of a standard normal variable, the latter but for 7.5e-8.

    With `jax.scipy.stats.norm.cdf` a program of the steps above takes twice as long to compile, and to run.
    Source: Abramowitz and Stegun (1964), 26.2.17, after Hastings (1955).
    """
    density = jnp.exp(-0.5 * z**2) * (2 * math.pi) ** -0.5
    t = 1 / (1 + 0.2316419 * jnp.abs(z))
    tail = jnp.zeros_like(t)
    for b in (1.330274429, -1.821255978, 1.781477937, -0.356563782, 0.319381530):
        tail = (tail + b) * t
    tail *= density
    return density, jnp.where(z < 0, tail, 1 - tail)
