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


class Belief(NamedTuple):
    """A Gaussian belief about the values, on its way to the posterior."""

    dual: Float[Array, " n"]
    """α with mean f = Kα."""
    W: Float[Array, "rows J J"]
    """What the answers say of the precision."""
    S: Float[Array, "rows J J"]
    """Covariance of the values of each row."""


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


def unknown(K: Float[Array, "n n"], rows: int) -> Belief:
    """What is believed of f ~ N(0, K) before any answer."""
    n = K.shape[0]
    S = blocks_of(K, rows)
    return Belief(jnp.zeros(n, K.dtype), jnp.zeros_like(S), S)


def blocks_of(K: Float[Array, "n n"], rows: int) -> Float[Array, "rows J J"]:
    """The blocks on the diagonal."""
    i, J = jnp.arange(rows), K.shape[0] // rows
    return K.reshape(rows, J, rows, J)[i, :, i]


class Answers(NamedTuple):
    """What was said of the values, each row about n / rows of them."""

    said: Said
    filled: Bool[Array, " rows"]
    """Rows that hold an answer."""
    noise: Noise
    """How answers err; `mistake` has one entry a row."""


def over_belief(f: Float[Array, " n"], S: Float[Array, "rows J J"], given: Answers):
    """Mean of the log likelihood, of its slope and of its curvature over the belief, for each row."""
    said, filled, noise = given
    rows, J, _ = S.shape
    z, weights = (jnp.asarray(x, f.dtype) for x in points(J))
    if J == 1:  # the common case, with derivatives written out
        u = f[None] + jnp.sqrt(S[:, 0, 0] + JITTER)[None] * z
        found = jax.vmap(lambda u: terms(u, said, noise))(u)
        value, slope, bend = (jnp.where(filled, weights @ x, 0.0) for x in found)
        return value, slope, bend[:, None, None]
    L = jnp.linalg.cholesky(S + JITTER * jnp.eye(J, dtype=f.dtype)[None])
    u = f.reshape(1, rows, J) + jnp.einsum("rij,zj->zri", L, z)
    mean = lambda of: jnp.tensordot(weights, jax.vmap(lambda u: for_each(of, u, said, noise))(u), 1)
    value = jnp.where(filled, mean(log_likelihood), 0.0)
    slope = jnp.where(filled[:, None], mean(jax.grad(log_likelihood)), 0.0)
    return value, slope.reshape(-1), jnp.where(filled[:, None, None], mean(curvature), 0.0)


class Factors(NamedTuple):
    """Of a precision W, in a prior K."""

    V: Float[Array, "rows J J"]
    """Blocks of V with VVᵀ = W."""
    KV: Float[Array, "n n"]
    L: Float[Array, "n n"]
    """Cholesky factor of I + VᵀKV."""


def factors(K: Float[Array, "n n"], W: Float[Array, "rows J J"], filled: Bool[Array, " rows"]) -> Factors:
    """Factors of the posterior's precision."""
    n, (rows, J, _) = K.shape[0], W.shape
    eye = jnp.eye(J, dtype=K.dtype)[None]
    V = jnp.where(filled[:, None, None], jnp.linalg.cholesky(W + JITTER * eye), 0.0)
    KV = jnp.einsum("nrj,rjk->nrk", K.reshape(n, rows, J), V).reshape(n, n)
    VKV = jnp.einsum("rji,rjm->rim", V, KV.reshape(rows, J, n)).reshape(n, n)
    return Factors(V, KV, jnp.linalg.cholesky(jnp.eye(n, dtype=K.dtype) + VKV))


def by_block(M: Float[Array, "rows J J"], x: Float[Array, " n"]) -> Float[Array, " n"]:
    """The product of a block diagonal matrix with x."""
    rows, J, _ = M.shape
    return jnp.einsum("rjk,rk->rj", M, x.reshape(rows, J)).reshape(-1)


def improved(K: Float[Array, "n n"], given: Answers, belief: Belief, *, steps: int) -> Belief:
    """A belief about f ~ N(0, K) after so many of Newton's steps.

    Args:
        K: prior covariance of the values, row by row.
        given: the answers.
        belief: where to begin: `unknown`, or what was believed under another prior.
        steps: Newton steps.
    """
    blocks = blocks_of(K, given.filled.shape[0])

    def newton(belief: Belief, _) -> tuple[Belief, None]:
        f = K @ belief.dual
        _, slope, bend = over_belief(f, belief.S, given)
        W = belief.W + STEP * (bend - belief.W)
        V, KV, L = factors(K, W, given.filled)
        b = by_block(W, f) + slope
        aim = b - by_block(V, jax.scipy.linalg.cho_solve((L, True), KV.T @ b))
        inner = jax.scipy.linalg.solve_triangular(L, KV.T, lower=True).reshape(-1, *blocks.shape[:2])
        S = blocks - jnp.einsum("nri,nrj->rij", inner, inner)
        return Belief(belief.dual + STEP * (aim - belief.dual), W, S), None

    return jax.lax.scan(newton, belief, length=steps)[0]


def evidence_of(K: Float[Array, "n n"], given: Answers, belief: Belief) -> Scalar:
    """Lower bound of the log marginal likelihood: how well the answers are explained, less what was learned."""
    L = factors(K, belief.W, given.filled).L
    inverse = jax.scipy.linalg.solve_triangular(L, jnp.eye(K.shape[0], dtype=K.dtype), lower=True)
    f = K @ belief.dual
    divergence = 0.5 * (jnp.sum(inverse**2) - K.shape[0] + belief.dual @ f) + jnp.sum(jnp.log(jnp.diag(L)))
    return jnp.sum(over_belief(f, belief.S, given)[0]) - divergence


def posterior_of(K: Float[Array, "n n"], given: Answers, belief: Belief) -> Posterior:
    """The belief in the form in which it is kept."""
    V, _, L = factors(K, belief.W, given.filled)
    rows, n = given.filled.shape[0], K.shape[0]
    # of the block diagonal matrix of V's blocks
    wide = jnp.einsum("rij,rs->risj", V, jnp.eye(rows, dtype=K.dtype)).reshape(n, n)
    root = jax.scipy.linalg.solve_triangular(L, wide.T, lower=True)
    return Posterior(belief.dual, K @ belief.dual, root, evidence_of(K, given, belief))
