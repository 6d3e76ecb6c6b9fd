"""EstReward(P, T), eq. (7): the reward learned from preferences, and the spread σ_g of a predicted one.

The default is exact: with g the difference of two sums of r(s, a) = φ(s, a)ᵀθ and θ ~ N(0, P), the posterior has a
closed form, which is that of a Gaussian process observed through sums over trajectories. At most a few dozen answers
come in, so a refit takes milliseconds. Where answers are not numbers, the
Gaussian nearest to the posterior takes its place.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hiprl.data.preference import Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.evidence import BOX_MARGIN, Evidence, evidence
from hiprl.models.features import AdditiveFeatures, Kernel, by_entry, parts_of
from hiprl.models.relevance import OF_NUMBERS, relevance_of, shares_of, spread_by
from hiprl.models.sums import columns, side_by_side, steps_of, values
from hiprl.models.usual import typical_size
from hiprl.types import Action, Reward, Scalar, State

ROUNDS = 5  # of finding relevance for the scales, and scales for the relevance
FEW = 16  # answers, up to which each entry is tried as the most relevant one
FOREMOST = 0.8  # share of all relevance that it has then
FINER = 1.0  # nats that a smooth part with a lengthscale e times as short has to earn
JUDGES = 16  # whose mistakes are told apart; further ones count as the last


class Gap(NamedTuple):
    """A predicted preference g(τ, τ′; r̂)."""

    mean: Scalar
    sigma: Scalar
    """σ_g: the spread of the belief about it."""


class EstimatedReward(Reward):
    """A learned r̂ that also says how sure it is of a preference."""

    unit: Scalar
    """Root mean square of r̂ over the usual steps: the scale of a reward."""

    @abstractmethod
    def gap(self, tau: Trajectory, other: Trajectory) -> Gap:
        """g(τ, τ′; r̂) and its σ_g, in the judge's unit."""

    @abstractmethod
    def returns(self, T: Trajectories) -> Float[Array, " N"]:
        """Sum of r̂ along each trajectory of T; minus infinity past the count."""


@dataclass(frozen=True, kw_only=True)
class AdditiveConfig:
    """How the closed-form reward is estimated."""

    smooth: tuple[float, ...] = (0.01, 0.1, 1.0, 10.0, 100.0)
    """Candidates for the variance of the smooth part, and with it of the square, over that of the linear part."""
    lengths: tuple[float, ...] = (4.0, 1.0, 0.5)
    """Candidates for the lengthscale of the smooth part, in standard deviations of most of what was seen."""
    noise: tuple[float, ...] = (1e-6, 1e-4, 1e-2)
    """Candidates for the variance of an answer's error, over the variance that the prior gives an answer; where all
    answers are numbers."""

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """Candidates for the smooth part; of short lengthscale and little variance it would be no more than ripples."""
        longest = max(self.lengths)
        return tuple(
            Kernel(variance, length)
            for length in self.lengths
            for variance in self.smooth
            if length == longest or variance >= 1
        )


def believed(kernels: tuple[Kernel, ...]) -> Float[np.ndarray, " kernels"]:
    """Log prior of each kernel, in nats: what is finer has to earn it."""
    length = np.array([kernel.length for kernel in kernels])
    return FINER * np.log(length / length.max())


class Errors(NamedTuple):
    """How those who answer were found to err."""

    kappa: Scalar
    """Scale of the error of perception, where a whole scale is 1."""
    mistakes: Float[Array, " judges"]
    """Share of each judge's answers that mean something else."""
    scale: Scalar
    """Size of r̂'s unit to who answers by levels, where a whole scale is 1 at the time of the newest answer."""
    spread: Scalar
    """Standard deviation of the belief about its logarithm: how much r̂ as a whole may be too large or too small."""

    @classmethod
    def of_numbers(cls) -> Errors:
        """Of who answers by numbers alone: nothing of this is known."""
        return cls(jnp.ones(()), jnp.zeros(JUDGES), jnp.ones(()), jnp.zeros(()))


class AdditiveReward(EstimatedReward):
    """r̂(s, a) = φ(s, a)ᵀm with the posterior of θ behind it, kept in the seen range plus a quarter."""

    features: AdditiveFeatures
    mean: Float[Array, " D"]
    """Posterior mean m of the weights."""
    prior: Float[Array, " D"]
    """Prior variance of the weights (P is diagonal)."""
    root: Float[Array, "n D"]
    """L⁻¹ΨP, so that S = P - rootᵀ root."""
    low: Scalar
    high: Scalar
    errors: Errors

    @property
    def going_on(self) -> float:
        """What every step is worth, whatever it is like; 0 where no answer tells. Not to be traced."""
        return float(self.mean[0])

    def __call__(self, s: State, a: Action) -> Scalar:
        return jnp.clip(self.features.dot(s, a, self.mean), self.low, self.high)

    def of_steps(self, s: Float[Array, "*n p"], a: Float[Array, "*n q"]) -> Float[Array, " *n"]:
        x = side_by_side(s.reshape(-1, s.shape[-1]), a.reshape(-1, a.shape[-1]))
        each = values(self.features, columns(self.features, x), self.mean)
        return jnp.clip(each, self.low, self.high).reshape(s.shape[:-1])

    def gap(self, tau: Trajectory, other: Trajectory) -> Gap:
        return self.gap_of(summed(self.features, tau) - summed(self.features, other))

    def gap_of(self, psi: Float[Array, " D"]) -> Gap:
        """The same for two clips whose sums of φ differ by ψ."""
        mean = psi @ self.mean
        var = jnp.sum(psi**2 * self.prior) - jnp.sum((self.root @ psi) ** 2)
        return Gap(mean, jnp.sqrt(jnp.maximum(var, 0.0) + (self.errors.spread * mean) ** 2))

    def returns(self, T: Trajectories) -> Float[Array, " N"]:
        return sums_of(self.features, T, self.mean)


def summed(features: AdditiveFeatures, tau: Trajectory) -> Float[Array, " D"]:
    """Φ(τ): the sum of φ over the executed steps. Sums, not means, so that lengths count."""
    rows = tau.transitions()
    phi = jax.vmap(features)(rows.s, rows.a)
    return jnp.sum(jnp.where(rows.mask[:, None], phi, 0.0), axis=0)


@jax.jit
def sums_of(features: AdditiveFeatures, T: Trajectories, weights: Float[Array, " D"]) -> Float[Array, " N"]:
    """Sum of φᵀ weights along each trajectory of T; minus infinity past the count."""
    each = values(features, columns(features, steps_of(T).x), weights).reshape(T.rows.actions.shape[:2])
    sums = jnp.sum(jnp.where(jax.vmap(Trajectory.transitions)(T.rows).mask, each, 0.0), axis=1)
    return jnp.where(T.filled, sums, -jnp.inf)


def estimate_additive_reward(
    P: Preferences, T: Trajectories, config: AdditiveConfig, *, longest: int | None = None
) -> AdditiveReward:
    """Posterior of the additive reward given answers that are all numbers, its scales chosen by marginal likelihood.

    Args:
        P: the answers.
        T: the trajectories they are about.
        config: candidates for the scales.
        longest: steps of the longest clip; P is looked at if None, which nothing that is traced can do.

    Source: HIP-RL eq. (7) and Theorem 4.3; the posterior of a linear model observed through sums.
    """
    seen = evidence(T, P, longest=longest)
    parts, shares = parts_of(seen.features, config.kernels)
    with jax.enable_x64(True):  # Cholesky of nearly dependent rows: answers are almost free of noise
        posterior = _posterior(
            jnp.asarray(seen.Psi[:, 0], jnp.float64),
            jnp.asarray(jnp.where(P.filled, P.g, 0.0), jnp.float64),
            P.filled,
            Candidates(
                parts.astype(jnp.float64),
                shares.astype(jnp.float64),
                jnp.asarray(believed(config.kernels)),
                jnp.asarray(config.noise, jnp.float64),
            ),
        )
        posterior = jax.tree.map(lambda x: x.astype(jnp.float32), posterior)
    mean, prior, root = posterior
    root = jnp.pad(root, ((0, P.capacity * (P.m - 2)), (0, 0)))  # as many rows as answers of any kind need
    return additive_reward(T, seen, mean, prior, root, Errors.of_numbers())


class Candidates(NamedTuple):
    """Scales among which the likeliest are found."""

    parts: Float[Array, "parts D"]
    """Prior variances of the weights, of which that for each kernel is a sum."""
    shares: Float[Array, "kernels parts"]
    """How often each part counts for each kernel."""
    believed: Float[Array, " kernels"]
    """Log prior of each kernel."""
    noises: Float[Array, " noises"]


@jax.jit
def _posterior(Psi: Float[Array, "K D"], g: Float[Array, " K"], filled: Bool[Array, " K"], among: Candidates):
    """Mean, prior variance and root for the likeliest scales: marginal likelihood times prior.

    While answers are few, many an entry may explain them, and from where all are alike each round only strengthens the
    mixture that came first: an r̂ that knows of nothing but effort, and rests. So each entry is tried as the first.
    """
    entries = by_entry(among.parts).shape[1]
    alike = jnp.ones(entries, Psi.dtype)

    def likeliest():
        few = slice(0, FEW)
        starts = jnp.concatenate([alike[None], FOREMOST * entries * jnp.eye(entries) + (1 - FOREMOST)])
        likely, _ = jax.vmap(lambda start: _settled(start, Psi[few], g[few], filled[few], among))(starts)
        return starts[jnp.argmax(likely)]

    start = jax.lax.cond(jnp.sum(filled) <= FEW, likeliest, lambda: alike)
    return _settled(start, Psi, g, filled, among)[1]


def _settled(
    start: Float[Array, " entries"],
    Psi: Float[Array, "K D"],
    g: Float[Array, " K"],
    filled: Bool[Array, " K"],
    among: Candidates,
):
    """Log likelihood, and mean, prior variance and root, from this relevance on.

    What is found relevant under one candidate changes which is the likeliest: they are found in turn.
    """
    n = jnp.maximum(jnp.sum(filled), 1)
    square = jnp.sum(g**2) / n
    least = jnp.where(square > 0, 1e-12 * square, 1.0)  # in the judge's unit, whatever that is

    def under(K: Float[Array, "K K"], noises: Float[Array, " some"]):
        """Log likelihood, Cholesky factor L, K⁻¹g and overall variance for each noise."""
        level = jnp.where(jnp.trace(K) > 0, jnp.trace(K) / n, 1.0)  # what the prior expects of g²

        def with_noise(noise: Scalar):
            L = jnp.linalg.cholesky(K + jnp.diag(jnp.where(filled, noise * level, 1.0)))
            G_g = jax.scipy.linalg.cho_solve((L, True), g)
            scale = jnp.maximum(g @ G_g / n, least)  # the overall variance, at its own optimum
            log_det = 2 * jnp.sum(jnp.where(filled, jnp.log(jnp.diag(L)), 0.0))
            return -0.5 * (n * jnp.log(scale) + log_det), L, G_g, scale

        return jax.lax.map(with_noise, noises)

    def one_round(before: tuple[Float[Array, " entries"], Scalar], _: None):
        relevance, noise = before
        parts = spread_by(among.parts, relevance)
        K_of = jax.lax.map(lambda part: (Psi * part[None]) @ Psi.T, parts)
        sum_of = lambda share, x: jnp.tensordot(share, x, 1)
        likely = jax.lax.map(lambda share: under(sum_of(share, K_of), noise[None])[0][0], among.shares)
        kernel = jnp.argmax(likely + among.believed)
        share = among.shares[kernel]
        prior = sum_of(share, parts)
        likely, L, G_g, scale = under(sum_of(share, K_of), among.noises)
        best = jnp.argmax(likely)
        L, G_g, scale = L[best], G_g[best], scale[best]
        half = jax.scipy.linalg.solve_triangular(L, Psi * prior[None], lower=True)
        posterior = prior * (Psi.T @ G_g), prior * scale, half * jnp.sqrt(scale)
        next_one = relevance_of(shares_of(*posterior, relevance), freedom=OF_NUMBERS), among.noises[best]
        return next_one, (likely[best] + among.believed[kernel], posterior)

    first = start, among.noises[len(among.noises) // 2]
    return jax.tree.map(lambda x: x[-1], jax.lax.scan(one_round, first, length=ROUNDS)[1])


@jax.jit
def additive_reward(T: Trajectories, seen: Evidence, mean, prior, root, errors: Errors) -> AdditiveReward:
    """The posterior with the range of r̂ over the executed steps of T."""
    r, T = seen.values(mean), T.executed()
    mask = T.transitions().mask
    low = jnp.min(jnp.where(mask, r, jnp.inf))
    high = jnp.max(jnp.where(mask, r, -jnp.inf))
    margin = BOX_MARGIN * (high - low)
    unit = typical_size(r, T)  # the seen range is within the box
    return AdditiveReward(unit, seen.features, mean, prior, root, low - margin, high + margin, errors)
