"""Features of a state and an action in which the latent reward is linear: a bias, and a function of each coordinate.

Each coordinate counts in proportion and, on top, by a smooth function.

The smooth part is a Gaussian process with squared exponential kernel in each standardised coordinate, written in the
first Mercer functions of that kernel under a standard normal input. With a lengthscale of 4 their prior variances
fall by a factor of 18 from one to the next, so that six say what 24 random Fourier features say, and nothing is drawn.
Source: Rasmussen and Williams (2006), section 4.3.1.
"""

from __future__ import annotations

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hiprl.models.network import Scaler
from hiprl.types import Action, Scalar, State

LENGTHSCALE = 4.0  # in standard deviations of the data
DEGREE = 6  # Mercer functions a coordinate

_A, _B = 0.25, 1 / (2 * LENGTHSCALE**2)
_C = math.sqrt(_A**2 + 2 * _A * _B)
_SUM = _A + _B + _C
EIGENVALUES = np.array([math.sqrt(2 * _A / _SUM) * (_B / _SUM) ** n for n in range(DEGREE)])
"""Prior variance of each Mercer function's weight, for a kernel of height 1."""
_NORMS = np.array([(_C / _A) ** 0.25 / math.sqrt(2.0**n * math.factorial(n)) for n in range(DEGREE)])


class AdditiveFeatures(eqx.Module):
    """φ(s, a) = (1, x, Mercer functions of each x_j) with x = (s, a) standardised and kept in the seen box.

    All but the bias have mean 0 over what was seen. So r̂ has no level of its own that could jump from one refit to
    the next: only where lengths differ do answers say something about a level, and then the bias carries it.
    """

    scaler: Scaler
    low: Float[Array, " n"]
    """Least standardised value that counts; smaller ones count as this."""
    high: Float[Array, " n"]
    centre: Float[Array, " D"]
    """Mean of the raw features over what was seen; 0 for the bias."""

    @property
    def size(self) -> int:
        """D, the number of features."""
        return 1 + self.low.shape[0] * (1 + DEGREE)

    def coordinates(self, s: State, a: Action) -> Float[Array, " n"]:
        """(s, a) in standard units, inside the box."""
        return jnp.clip(self.scaler.down(jnp.concatenate([s, a])), self.low, self.high)

    def __call__(self, s: State, a: Action) -> Float[Array, " D"]:
        return raw_features(self.coordinates(s, a)) - self.centre

    def dot(self, s: State, a: Action, weights: Float[Array, " D"]) -> Scalar:
        """φ(s, a)ᵀ weights without writing φ out: what a search evaluates at every imagined step."""
        x = self.coordinates(s, a)
        n = x.shape[0]
        by_degree = weights[1 + n :].reshape(n, DEGREE)
        smooth = sum(by_degree[:, m] * h for m, h in enumerate(hermite(x)))
        return weights[0] + weights[1 : 1 + n] @ x + jnp.sum(envelope(x) * smooth) - self.centre @ weights

    def prior(self, linear: Float[Array, ""], smooth: Float[Array, ""]) -> Float[Array, " D"]:
        """Prior variance of each weight, for these variances of the linear and of the smooth part."""
        n = self.low.shape[0]
        # The bias decides where lengths differ and is nowhere else seen: its prior is as wide as all the rest.
        bias = n * (linear + smooth)
        tail = jnp.broadcast_to(smooth * EIGENVALUES, (n, DEGREE)).reshape(-1)
        return jnp.concatenate([bias[None], jnp.full(n, linear), tail])


def raw_features(x: Float[Array, " n"]) -> Float[Array, " D"]:
    """(1, x, Mercer functions of each x_j)."""
    return jnp.concatenate([jnp.ones(1), x, mercer(x).reshape(-1)])


def hermite(x: Float[Array, " n"]) -> list[Float[Array, " n"]]:
    """Hermite polynomials by degree, each with the factor that makes it a Mercer function but for the envelope."""
    u = math.sqrt(2 * _C) * x
    H = [jnp.ones_like(u), 2 * u]
    for n in range(1, DEGREE - 1):
        H.append(2 * u * H[n] - 2 * n * H[n - 1])
    return [norm * h for norm, h in zip(_NORMS.tolist(), H, strict=True)]


def envelope(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """What all Mercer functions have in common: they fall off slowly away from the data."""
    return jnp.exp(-(_C - _A) * x**2)


def mercer(x: Float[Array, " n"]) -> Float[Array, "n m"]:
    """The first Mercer functions of the squared exponential kernel at each standardised coordinate."""
    return envelope(x)[:, None] * jnp.stack(hermite(x), axis=1)
