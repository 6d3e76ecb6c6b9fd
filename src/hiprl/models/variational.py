"""The Gaussian nearest to the posterior of a Gaussian process, given answers of any kind about its values.

A choice between two clips says on which side of zero a difference lies and no more, so posteriors are skewed, and their
mode is far from their mean. Hence Newton's steps look at the likelihood not at one point but over the present belief:
their fixed point is the Gaussian of least divergence from the posterior. The prior covariance K of the values at the
answers is given as A with AAᵀ = K, and a step works in the columns of A: there are as many as there is to know about
the values, which for many answers is less than answers or features.
Source: Opper and Archambeau (2009); Khan and Rue (2023) for the steps; Rasmussen and Williams (2006), section 3.4;
Fine and Scheinberg (2001) for A.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hiprl.data.preference import Kind, Said
from hiprl.models.averaged import MOST, averaged, beyond_gaussian
from hiprl.models.likelihood import Derivatives, Noise, ranking
from hiprl.types import Count, Flag, Scalar

JITTER = 1e-10
ROUNDING = 10.0  # errors of the last bit that a covariance may have
WIDER, STEPS = (10.0, 3.0), 6  # how much less exact a judge is on the way from no belief, and steps for each
DRAWS = 24  # pairs of points over several values


class Belief(NamedTuple):
    """A Gaussian belief about the values, on its way to the posterior."""

    dual: Float[Array, " n"]
    """α with mean f = Kα."""
    W: Float[Array, "rows J J"]
    """What the answers say of the precision."""
    S: Float[Array, "rows J J"]
    """Covariance of the values of each row."""
    log_det: Scalar
    """log |I + KW|: twice how much less is unknown, in nats."""
    evidence: Scalar
    """Lower bound of the log marginal likelihood: how well the answers are explained, less what was learned; minus
    infinity before any step."""


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
    half = np.random.default_rng(0).normal(size=(DRAWS, J))
    x = np.concatenate([half, -half])
    x = x @ np.linalg.inv(np.linalg.cholesky(x.T @ x / len(x))).T  # their covariance is exactly one
    return x, np.full(len(x), 1 / len(x))


def thin(K: Float[Array, "n n"], rank: int) -> Float[Array, "n rank"]:
    """A with AAᵀ = K but for what few columns leave out.

    The pivoted Cholesky factor, which takes next the value of which it leaves out the greatest share. What is left out
    of a value's prior variance only falls with the rank, and never makes a variance negative.
    """
    std = jnp.sqrt(jnp.diag(K))
    inverse = jnp.where(std > 0, 1 / jnp.where(std > 0, std, 1.0), 0.0)
    R = K * jnp.outer(inverse, inverse)

    def column(i, carry):
        A, left = carry
        p = jnp.argmax(left)
        a = R[p] - A.T @ A[:, p]
        a = jnp.where(left[p] > JITTER, a / jnp.sqrt(jnp.maximum(left[p], JITTER)), 0.0)
        return A.at[i].set(a), jnp.maximum(left - a**2, 0.0)

    start = jnp.zeros((rank, len(K)), K.dtype), jnp.diag(R)
    return std[:, None] * jax.lax.fori_loop(0, rank, column, start)[0].T


def unknown(A: Float[Array, "n r"], rows: int) -> Belief:
    """What is believed of f ~ N(0, AAᵀ) before any answer."""
    S = blocks_of(A.T, rows)
    return Belief(jnp.zeros(len(A), A.dtype), jnp.zeros_like(S), S, jnp.zeros((), A.dtype), unseen(A))


def unseen(A: Float[Array, "n r"]) -> Scalar:
    """What a belief of which nothing is known yet reaches."""
    return jnp.asarray(-jnp.inf, A.dtype)


def blocks_of(B: Float[Array, "r n"], rows: int) -> Float[Array, "rows J J"]:
    """The blocks on the diagonal of BᵀB."""
    if B.shape[1] == rows:
        return jnp.sum(B**2, axis=0)[:, None, None]
    B = B.reshape(B.shape[0], rows, -1)
    return jnp.einsum("nri,nrj->rij", B, B)


def root_of(S: Float[Array, "rows J J"]) -> Float[Array, "rows J J"]:
    """L with LLᵀ = S, also where the values of a row are as good as one and rounding left S without a factor."""
    J = S.shape[-1]
    jitter = JITTER + ROUNDING * jnp.finfo(S.dtype).eps * jnp.trace(S, axis1=1, axis2=2)
    return jnp.linalg.cholesky(S + jitter[:, None, None] * jnp.eye(J, dtype=S.dtype)[None])


class Answers(NamedTuple):
    """What was said of the values, each row about n / rows of them."""

    said: Said
    filled: Bool[Array, " rows"]
    """Rows that hold an answer."""
    noise: Noise
    """How answers err; `mistake` has one entry a row."""


def over_belief(f: Float[Array, " n"], S: Float[Array, "rows J J"], given: Answers):
    """Mean of the log likelihood, of its slope and of its curvature over the belief, for each row.

    In closed form where one value is all that counts, over draws for a ranking of many.
    """
    said, filled, noise = given
    rows, J, _ = S.shape
    value, first, bend_first = averaged(f.reshape(rows, J)[:, 0], S[:, 0, 0], said, noise)
    if J == 1:
        slope, bend = first, bend_first[:, None, None]
    else:
        u, weights = draws_of(f, S)
        ranked = jax.tree.map(lambda x: jnp.einsum("z,...zr->r...", weights, x), of_rankings(u, said, noise))
        slope, bend = jnp.zeros_like(S[:, 0]).at[:, 0].set(first), jnp.zeros_like(S).at[:, 0, 0].set(bend_first)
        of_one, is_ranking = Derivatives(value, slope, bend), said.kind == Kind.RANKING
        value, slope, bend = jax.tree.map(partial(chosen_rows, is_ranking), ranked, of_one)
    value, slope, bend = (chosen_rows(filled, x, jnp.zeros_like(x)) for x in (value, slope, bend))
    return value, slope.reshape(-1), bend


def chosen_rows(which: Bool[Array, " rows"], x: Float[Array, "rows ..."], other: Float[Array, "rows ..."]) -> Array:
    """These rows of the one, all others of the other."""
    return jnp.where(which.reshape(-1, *[1] * (x.ndim - 1)), x, other)


def draws_of(
    f: Float[Array, " n"], S: Float[Array, "rows J J"]
) -> tuple[Float[Array, "J draws rows"], Float[Array, " draws"]]:
    """Draws of the values of each row from the belief, and their weights."""
    rows, J, _ = S.shape
    z, weights = (jnp.asarray(x, f.dtype) for x in points(J))
    return f.reshape(rows, J).T[:, None] + jnp.einsum("rij,zj->izr", root_of(S), z), weights


def of_rankings(u: Float[Array, "J draws rows"], said: Said, noise: Noise) -> Derivatives:
    """Each answer at each draw, as if it was a ranking; rows come last, side by side in memory."""
    one = lambda u, said, mistake: ranking(u, said, Noise(noise.kappa, noise.var, mistake))
    rows = jax.vmap(one, in_axes=-1, out_axes=-1)
    return jax.vmap(lambda u: rows(u, said, noise.mistake), in_axes=1, out_axes=-2)(u)


def by_block(M: Float[Array, "rows J J"], X: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """The product of a block diagonal matrix with X."""
    rows, J, _ = M.shape
    if J == 1:
        return M.reshape(rows, *[1] * (X.ndim - 1)) * X
    return jnp.einsum("rjk,rk...->rj...", M, X.reshape(rows, J, *X.shape[1:])).reshape(X.shape)


class Climb(NamedTuple):
    """Where Newton's steps are."""

    number: Count
    at: Belief
    """Where the last step led."""
    best: Belief
    """The last belief that was better than all before."""
    slope: Float[Array, " n"]
    """Of the mean log likelihood there."""
    bend: Float[Array, "rows J J"]
    gain: Scalar
    """By how much the last step was better, if it had been a whole one."""
    step: Scalar
    """Share of the way of the next step."""


def improved(
    A: Float[Array, "n r"], given: Answers, belief: Belief, *, steps: Count | int, enough: float = 0.0
) -> Belief:
    """A belief about f ~ N(0, AAᵀ) after some of Newton's steps; one that makes it worse is taken back and shortened.

    Args:
        A: factor of the prior covariance of the values, row by row.
        given: the answers.
        belief: where to begin: `unknown`, or what was believed under another prior.
        steps: Newton steps, at most.
        enough: gain of a whole step in nats below which it is the last.
    """
    rows, eye = given.filled.shape[0], jnp.eye(A.shape[1], dtype=A.dtype)

    def towards(belief: Belief, slope: Array, bend: Array, step: Scalar) -> Belief:
        f = A @ (A.T @ belief.dual)
        W = belief.W + step * (bend - belief.W)
        L = jnp.linalg.cholesky(eye + A.T @ by_block(W, A))  # LLᵀ is the precision of z where f = Az
        half = jax.scipy.linalg.solve_triangular(L, A.T, lower=True)
        b = by_block(W, f) + slope
        aim = b - by_block(W, half.T @ (half @ b))
        log_det = 2 * jnp.sum(jnp.log(jnp.diag(L)))
        return Belief(belief.dual + step * (aim - belief.dual), W, blocks_of(half, rows), log_det, unseen(A))

    def looked(climb: Climb) -> Climb:
        """The same with what the last step came to."""
        z = A.T @ climb.at.dual
        value, slope, bend = over_belief(A @ z, climb.at.S, given)
        at = climb.at._replace(evidence=jnp.sum(value) - divergence(z, climb.at))
        gain = at.evidence - climb.best.evidence
        good = gain >= 0
        here, there = (at, slope, bend), (climb.best, climb.slope, climb.bend)
        best, slope, bend = jax.tree.map(lambda x, y: jnp.where(good, x, y), here, there)
        step = jnp.where(good, jnp.minimum(1.0, 2 * climb.step), climb.step / 4)
        gain = jnp.where(good & (climb.number > 0), gain / climb.step, jnp.inf)  # not there yet
        return Climb(climb.number, at, best, slope, bend, gain, step)

    def newton(climb: Climb) -> Climb:
        at = towards(climb.best, climb.slope, climb.bend, climb.step)
        return looked(climb._replace(at=at, number=climb.number + 1))

    of = lambda x: jnp.asarray(x, A.dtype)
    nothing = jnp.zeros_like(belief.dual), jnp.zeros_like(belief.W)
    here = towards(belief, *nothing, of(0.0))  # what was believed before, under this prior
    begin = Climb(jnp.zeros((), jnp.int32), here, here, *nothing, of(jnp.inf), of(1.0))
    going = lambda climb: (climb.number < steps) & (climb.gain > enough)
    return jax.lax.while_loop(going, newton, looked(begin)).best


def begun(A: Float[Array, "n r"], given: Answers, belief: Belief) -> Belief:
    """Where to begin: the better of a belief under another prior, and of one that is reached from none.

    The first is mostly near. Where it is far off, good answers would be explained as mistakes from there on. The way
    to the second leads past answers of judges who are less exact and never mistaken: those have one explanation only.
    """

    def on_the_way(before: Belief, stage: tuple[Scalar, Flag]) -> tuple[Belief, Belief]:
        wider, last = stage
        noise = Noise(given.noise.kappa * wider, given.noise.var, jnp.where(wider > 1, 0.0, given.noise.mistake))
        start = jax.tree.map(partial(jnp.where, last), belief, before)
        after = improved(A, given._replace(noise=noise), start, steps=STEPS, enough=1.0)
        return after, after

    stages = jnp.asarray([*WIDER, 1.0, 1.0], A.dtype), jnp.arange(len(WIDER) + 2) > len(WIDER)
    _, found = jax.lax.scan(on_the_way, unknown(A, given.filled.shape[0]), stages)  # one loop is compiled once
    best = len(WIDER) + jnp.argmax(found.evidence[len(WIDER) :])
    return jax.tree.map(lambda x: x[best], found)


def divergence(z: Float[Array, " r"], belief: Belief) -> Scalar:
    """Of the belief about z, whose mean this is, from its prior, in nats."""
    return 0.5 * (belief.log_det + z @ z - jnp.sum(belief.W * belief.S))  # tr (I + KW)⁻¹ = n - tr WS


def left_out(A: Float[Array, "n r"], given: Answers, belief: Belief) -> Scalar:
    """By how much the bound is too low, each answer by itself: in closed form, or for rankings of many to second order.

    The second order is half the variance over the belief of what is neither linear nor quadratic in a log likelihood.
    Without all this, scales would be found too small: the larger they are, the less a belief after a choice looks like
    a Gaussian.
    """
    said, filled, noise = given
    rows, J, _ = belief.S.shape
    f = A @ (A.T @ belief.dual)
    first = lambda x: x.reshape(rows, J)[:, 0]
    rest = beyond_gaussian(first(f), belief.S[:, 0, 0], first(belief.dual), belief.W[:, 0, 0], said, noise)
    if J > 1:
        z, weights = (jnp.asarray(x, A.dtype) for x in points(J))
        value = of_rankings(draws_of(f, belief.S)[0], said, noise).value
        value = value - (weights @ value)[None]
        linear = jnp.einsum("z,zr,zi->ri", weights, value, z)
        quadratic = jnp.einsum("z,zr,zi,zj->rij", weights, value, z, z)
        of_many = weights @ value**2 - jnp.sum(linear**2, axis=1) - 0.5 * jnp.sum(quadratic**2, axis=(1, 2))
        rest = jnp.where(said.kind == Kind.RANKING, jnp.clip(0.5 * of_many, 0.0, MOST), rest)
    return jnp.sum(jnp.where(filled, rest, 0.0))


def posterior_of(A: Float[Array, "n r"], given: Answers, belief: Belief) -> Posterior:
    """The belief in the form in which it is kept."""
    K = A @ A.T
    level, axes = jnp.linalg.eigh(belief.W)  # no Cholesky factor: rounding can leave a level below zero
    V = jnp.where(given.filled[:, None, None], axes * jnp.sqrt(jnp.maximum(level, 0.0))[:, None], 0.0)  # VVᵀ = W
    turned, eye = V.swapaxes(1, 2), jnp.eye(len(K), dtype=A.dtype)
    L = jnp.linalg.cholesky(eye + by_block(turned, by_block(turned, K).T))  # of I + VᵀKV
    root = jax.scipy.linalg.solve_triangular(L, by_block(turned, eye), lower=True)
    return Posterior(belief.dual, K @ belief.dual, root, belief.evidence)
