"""The Gaussian nearest to the posterior of a Gaussian process, given answers of any kind about its values.

A choice between two clips says on which side of zero a difference lies and no more, so posteriors are skewed, and their
mode is far from their mean. Hence Newton's steps look at the likelihood not at one point but over the present belief:
their fixed point is the Gaussian of least divergence from the posterior. Written in the values at the answers, so that
the cost is that of the number of answers and not of the features.
Source: Opper and Archambeau (2009); Khan and Rue (2023) for the steps; Rasmussen and Williams (2006), section 3.4.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hiprl.data.preference import Said
from hiprl.models.likelihood import Noise, curvature, for_each, log_likelihood, terms
from hiprl.types import Scalar

JITTER = 1e-10
STEP = 0.7  # share of the way to the aim of a Newton step
NODES = 11  # of the quadrature over one value
DRAWS = 24  # pairs of points over several


class Posterior(NamedTuple):
    """A Gaussian belief about the values."""

    dual: Float[Array, " n"]
    """α with mean f = Kα."""
    f: Float[Array, " n"]
    """The mean."""
    root: Float[Array, "n n"]
    """R with S = K - K RᵀR K."""
    evidence: Scalar
    """Lower bound of the log marginal likelihood."""


def points(J: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights with which the mean over a standard normal in J dimensions is taken."""
    if J == 1:
        x, w = np.polynomial.hermite_e.hermegauss(NODES)
        return x[:, None], w / w.sum()
    half = np.random.default_rng(0).normal(size=(DRAWS, J))
    x = np.concatenate([half, -half])
    x = x @ np.linalg.inv(np.linalg.cholesky(x.T @ x / len(x))).T  # their covariance is exactly one
    return x, np.full(len(x), 1 / len(x))


def approximate(
    K: Float[Array, "n n"], said: Said, filled: Bool[Array, " rows"], noise: Noise, *, steps: int
) -> Posterior:
    """The belief about f ~ N(0, K) given the answers in the filled rows, each about n / rows of the values.

    Args:
        K: prior covariance of the values, row by row.
        said: a stack of answers.
        filled: rows that hold an answer.
        noise: how answers err; `mistake` has one entry a row.
        steps: Newton steps.
    """
    rows, n = filled.shape[0], K.shape[0]
    J = n // rows
    z, weights = (jnp.asarray(x, K.dtype) for x in points(J))
    blocks = K.reshape(rows, J, rows, J)[jnp.arange(rows), :, jnp.arange(rows)]
    mask = filled[:, None, None]

    def over_belief(f: Float[Array, " n"], S: Float[Array, "rows J J"]):
        """Mean of the log likelihood, of its slope and of its curvature, for each row."""
        if J == 1:  # the common case, with derivatives written out
            u = f[None] + jnp.sqrt(S[:, 0, 0] + JITTER)[None] * z
            found = jax.vmap(lambda u: terms(u, said, noise))(u)
            value, slope, bend = (jnp.where(filled, weights @ x, 0.0) for x in found)
            return value, slope, bend[:, None, None]
        L = jnp.linalg.cholesky(S + JITTER * jnp.eye(J, dtype=K.dtype)[None])
        u = f.reshape(1, rows, J) + jnp.einsum("rij,zj->zri", L, z)
        mean = lambda of: jnp.tensordot(weights, jax.vmap(lambda u: for_each(of, u, said, noise))(u), 1)
        value = jnp.where(filled, mean(log_likelihood), 0.0)
        slope = jnp.where(filled[:, None], mean(jax.grad(log_likelihood)), 0.0)
        return value, slope.reshape(n), jnp.where(mask, mean(curvature), 0.0)

    def factors(W: Float[Array, "rows J J"]):
        """V, in blocks, with VVᵀ = W; KV; and the Cholesky factor of I + VᵀKV."""
        V = jnp.where(mask, jnp.linalg.cholesky(W + JITTER * jnp.eye(J, dtype=K.dtype)[None]), 0.0)
        KV = jnp.einsum("nrj,rjk->nrk", K.reshape(n, rows, J), V).reshape(n, n)
        VKV = jnp.einsum("rji,rjm->rim", V, KV.reshape(rows, J, n)).reshape(n, n)
        return V, KV, jnp.linalg.cholesky(jnp.eye(n, dtype=K.dtype) + VKV)

    times = lambda V, x: jnp.einsum("rjk,rk->rj", V, x.reshape(rows, J)).reshape(n)

    def newton(carry, _):
        dual, f, W, S = carry
        _, slope, new_W = over_belief(f, S)
        W = W + STEP * (new_W - W)
        V, KV, L = factors(W)
        b = jnp.einsum("rjk,rk->rj", W, f.reshape(rows, J)).reshape(n) + slope
        aim = b - times(V, jax.scipy.linalg.cho_solve((L, True), KV.T @ b))
        dual = dual + STEP * (aim - dual)
        inner = jax.scipy.linalg.solve_triangular(L, KV.T, lower=True).reshape(n, rows, J)
        S = blocks - jnp.einsum("nri,nrj->rij", inner, inner)
        return (dual, K @ dual, W, S), None

    start = jnp.zeros(n, K.dtype), jnp.zeros(n, K.dtype), jnp.zeros_like(blocks), blocks
    (dual, f, W, S), _ = jax.lax.scan(newton, start, length=steps)
    V, _, L = factors(W)
    # of the block diagonal matrix of V's blocks
    wide = jnp.einsum("rij,rs->risj", V, jnp.eye(rows, dtype=K.dtype)).reshape(n, n)
    root = jax.scipy.linalg.solve_triangular(L, wide.T, lower=True)
    inverse = jax.scipy.linalg.solve_triangular(L, jnp.eye(n, dtype=K.dtype), lower=True)
    divergence = 0.5 * (jnp.sum(inverse**2) - n + dual @ f) + jnp.sum(jnp.log(jnp.diag(L)))
    return Posterior(dual, f, root, jnp.sum(over_belief(f, S)[0]) - divergence)
