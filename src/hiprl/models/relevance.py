"""Which entries of a state and an action a reward goes by: each one's function has a variance of its own.

What is wanted is mostly a matter of a few entries, and nobody says which. With one variance for all, what a few answers
leave open is spread over all of them, and a search finds it; with one for each, found from the answers, an entry that
explains nothing falls silent. The variances have a scaled inverse χ² prior, which makes the prior of a function a
Student t, and are found by expectation and maximisation.
Source: MacKay (1994) and Neal (1996), automatic relevance determination; Tipping (2001).
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hiprl.models.features import FREQUENCIES, INSIDE, OWN, REACH, WAVES, by_entry

OF_NUMBERS, OF_ANSWERS = 0.2, 0.5
"""Degrees of freedom of the prior: the fewer, the more an entry may stand out or fall silent. A few numbers say so
exactly what is wanted that entries may; choices and levels do not, and r̂ would be surer than it is right."""


def _size() -> Float[np.ndarray, "m m"]:
    """C with |wᵀC|² the variance of x ↦ wᵀφ(x) for a standard normal x."""
    x, p = np.polynomial.hermite_e.hermegauss(80)
    angle = np.clip(x, -INSIDE, INSIDE)[:, None] + REACH
    phi = np.concatenate([x[:, None], x[:, None] ** 2, np.sin(FREQUENCIES * angle) / np.sqrt(REACH)], axis=1)
    phi = phi - (p / p.sum()) @ phi
    return np.linalg.cholesky((phi * (p / p.sum())[:, None]).T @ phi + 1e-9 * np.eye(OWN + WAVES))


SIZE = _size()


def spread_by(prior: Float[Array, "*n D"], relevance: Float[Array, " entries"]) -> Float[Array, "*n D"]:
    """The prior variance of θ where that of each entry is so many times as large."""
    factors = jnp.concatenate([jnp.ones(1, prior.dtype), relevance, relevance, jnp.repeat(relevance, WAVES)])
    return prior * jnp.broadcast_to(factors, prior.shape)


def shares_of(
    mean: Float[Array, " D"],
    prior: Float[Array, " D"],
    root: Float[Array, "n D"],
    before: Float[Array, " entries"],
) -> Float[Array, " entries"]:
    """The variance that each entry is found to have, where the prior gives it a mean of 1: the step of expectation.

    Args:
        mean: posterior mean of θ.
        prior: its prior variance.
        root: R with posterior covariance diag(prior) - RᵀR.
        before: the relevance in this prior.
    """
    size = jnp.asarray(SIZE, mean.dtype)
    expected = jnp.sum(by_entry(prior) * jnp.sum(size**2, axis=1)[None], axis=1)
    learned = jnp.sum((by_entry(root) @ size) ** 2, axis=(0, 2))
    found = jnp.sum((by_entry(mean) @ size) ** 2, axis=1) + jnp.maximum(expected - learned, 0.0)
    return jnp.where(expected > 0, found / jnp.where(expected > 0, expected, 1.0), 1.0) * before


def relevance_of(shares: Float[Array, " entries"], *, freedom: float) -> Float[Array, " entries"]:
    """Relevance by what was found of each entry's variance: the step of maximisation.

    Args:
        shares: of a prior whose overall size is the likeliest one; else over their mean.
        freedom: degrees of freedom of its own prior.
    """
    after = (freedom + shares) / (freedom + 1)
    return after / jnp.mean(after)
