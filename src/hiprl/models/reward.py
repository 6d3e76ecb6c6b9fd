"""EstReward(P, T), eq. (7): the reward learned from preferences, and the spread σ_g of a predicted one.

The default is exact: with g the difference of two sums of r(s, a) = φ(s, a)ᵀθ and θ ~ N(0, P), the posterior has a
closed form, which is that of a Gaussian process observed through sums over trajectories. At most a few dozen answers
come in, so a refit takes milliseconds. Where answers are not numbers, the
Gaussian nearest to the posterior takes its place.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from hiprl.data.preference import Clip, Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.features import AdditiveFeatures, Kernel, by_entry, priors_of, size_of
from hiprl.models.network import Scaler
from hiprl.models.relevance import relevance_of, spread_by
from hiprl.models.sums import columns, every_step, side_by_side, total, values
from hiprl.models.usual import typical_size
from hiprl.types import Action, Reward, Scalar, State

BOX_MARGIN = 0.25  # how far past the seen range a coordinate, and the reward itself, may count
ROUNDS = 5  # of finding relevance for the scales, and scales for the relevance
FINER = 1.0  # nats that a smooth part with a lengthscale e times as short has to earn
MANY = 16_384  # steps over which the features' mean is taken where there are more
JUDGES = 16  # whose mistakes are told apart; further ones count as the last
TOGETHER, PART = 8, 512  # clips, and steps, whose features are made at a time: what stays near the processor


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
    """Candidates for the variance of the smooth part over that of the linear part."""
    lengths: tuple[float, ...] = (4.0, 1.0, 0.5)
    """Candidates for the lengthscale of the smooth part, in standard deviations of what was seen."""
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

    def gap(self, tau: Trajectory, other: Trajectory) -> Gap:
        return self.gap_of(summed(self.features, tau) - summed(self.features, other))

    def gap_of(self, psi: Float[Array, " D"]) -> Gap:
        """The same for two clips whose sums of φ differ by ψ."""
        mean = psi @ self.mean
        var = jnp.sum(psi**2 * self.prior) - jnp.sum((self.root @ psi) ** 2)
        return Gap(mean, jnp.sqrt(jnp.maximum(var, 0.0) + (self.errors.spread * mean) ** 2))

    def returns(self, T: Trajectories) -> Float[Array, " N"]:
        return jnp.where(T.filled, sums_of(self.features, T, self.mean), -jnp.inf)


def summed(features: AdditiveFeatures, tau: Trajectory) -> Float[Array, " D"]:
    """Φ(τ): the sum of φ over the executed steps. Sums, not means, so that lengths count."""
    rows = tau.transitions()
    phi = jax.vmap(features)(rows.s, rows.a)
    return jnp.sum(jnp.where(rows.mask[:, None], phi, 0.0), axis=0)


@jax.jit
def sums_of(features: AdditiveFeatures, T: Trajectories, weights: Float[Array, " D"]) -> Float[Array, " N"]:
    """Sum of φᵀ weights along each trajectory of T."""
    each = values(features, every_step(features, T), weights).reshape(T.rows.actions.shape[:2])
    return jnp.sum(jnp.where(jax.vmap(Trajectory.transitions)(T.rows).mask, each, 0.0), axis=1)


def features_of(T: Trajectories) -> AdditiveFeatures:
    """Features standardised over T, with the box of what T has seen, a margin added."""
    rows = T.transitions()
    x = side_by_side(rows.s, rows.a)
    alone = jax.vmap(lambda x: Scaler.of(x[:, None], rows.mask))(x)
    scaler = jax.tree.map(lambda each: each[:, 0], alone)
    least = scaler.down(jnp.min(jnp.where(rows.mask[None], x, jnp.inf), axis=1))
    most = scaler.down(jnp.max(jnp.where(rows.mask[None], x, -jnp.inf), axis=1))
    margin = BOX_MARGIN * (most - least)
    features = AdditiveFeatures(scaler, least - margin, most + margin, jnp.zeros(size_of(x.shape[0]), x.dtype))
    some = slice(None, None, 1 + x.shape[1] // MANY)  # a mean of many does not need them all
    each = lambda x: total(features, columns(features, x[0]), x[1])
    whole = jnp.sum(jax.lax.map(each, (in_parts(x[:, some]), in_parts(rows.mask[None, some])[:, 0])), axis=0)
    centre = (whole / jnp.maximum(whole[0], 1)).at[0].set(0.0)
    return eqx.tree_at(lambda f: f.centre, features, centre)


def in_parts(x: Shaped[Array, "n steps"]) -> Shaped[Array, "parts n PART"]:
    """Some steps at a time, with zeros at the end."""
    x = jnp.pad(x, ((0, 0), (0, -x.shape[1] % PART)))
    return x.reshape(x.shape[0], -1, PART).swapaxes(0, 1)


def clip_sum(features: AdditiveFeatures, T: Trajectories, clip: Clip, steps: int) -> Float[Array, " D"]:
    """Sum of φ over a clip of at most `steps` steps; 0 for nobody's."""
    n = jnp.minimum(clip.length, jnp.maximum(T.rows.length[clip.of] - clip.start, 0))
    t = jnp.arange(steps)
    shown = (t < n) & (clip.of >= 0)
    at = jnp.where(shown, clip.start + t, 0)
    clean = lambda x: jnp.where(shown[:, None], x[clip.of, at], 0.0)  # the clip alone, not its whole trajectory
    return total(features, columns(features, side_by_side(clean(T.rows.states), clean(T.rows.actions))), shown)


def clip_sums(features: AdditiveFeatures, T: Trajectories, clips: Clip, steps: int) -> Float[Array, "clips D"]:
    """The same for each of a stack of clips, a few at a time."""
    return jax.lax.map(lambda clip: clip_sum(features, T, clip, steps), clips, batch_size=TOGETHER)


def most_steps(P: Preferences, T: Trajectories) -> int:
    """Steps of the longest clip in P, rounded up so that few programs serve all. Not to be traced."""
    H = T.rows.actions.shape[1]
    longest = int(jnp.max(jnp.where(P.filled[:, None], P.clips.length, 1), initial=1))
    return min(H, 1 << (longest - 1).bit_length())


@partial(jax.jit, static_argnames=("steps",))
def evidence(T: Trajectories, P: Preferences, *, steps: int) -> tuple[AdditiveFeatures, Float[Array, "K J D"]]:
    """Features of T, and Ψ: the sum of φ over each clip of an answer less that over its last one."""
    features = features_of(T)
    Phi = clip_sums(features, T, jax.tree.map(lambda x: x.reshape(-1), P.clips), steps).reshape(*P.clips.of.shape, -1)
    last = jnp.take_along_axis(Phi, jnp.maximum(P.said.items - 1, 0)[:, None, None], axis=1)
    used = P.filled[:, None] & (jnp.arange(P.m - 1)[None] < P.said.items[:, None] - 1)
    return features, jnp.where(used[..., None], Phi[:, :-1] - last, 0.0)


def estimate_additive_reward(
    P: Preferences, T: Trajectories, config: AdditiveConfig, *, steps: int | None = None
) -> AdditiveReward:
    """Posterior of the additive reward given answers that are all numbers, its scales chosen by marginal likelihood.

    Args:
        P: the answers.
        T: the trajectories they are about.
        config: candidates for the scales.
        steps: of the longest clip; as many as an episode may have if None.

    Source: HIP-RL eq. (7) and Theorem 4.3; the posterior of a linear model observed through sums.
    """
    features, Psi = evidence(T, P, steps=T.rows.actions.shape[1] if steps is None else steps)
    kernels, noises = config.kernels, len(config.noise)
    priors = priors_of(features, kernels)
    with jax.enable_x64(True):  # Cholesky of nearly dependent rows: answers are almost free of noise
        posterior = _posterior(
            jnp.asarray(Psi[:, 0], jnp.float64),
            jnp.asarray(jnp.where(P.filled, P.g, 0.0), jnp.float64),
            P.filled,
            jnp.repeat(priors.astype(jnp.float64), noises, axis=0),
            jnp.tile(jnp.asarray(config.noise, jnp.float64), len(kernels)),
            jnp.repeat(jnp.asarray(believed(kernels)), noises),
        )
        posterior = jax.tree.map(lambda x: x.astype(jnp.float32), posterior)
    mean, prior, root = posterior
    root = jnp.pad(root, ((0, P.capacity * (P.m - 2)), (0, 0)))  # as many rows as answers of any kind need
    return additive_reward(T, features, mean, prior, root, Errors.of_numbers())


@jax.jit
def _posterior(
    Psi: Float[Array, "K D"],
    g: Float[Array, " K"],
    filled: Bool[Array, " K"],
    priors: Float[Array, "G D"],
    noises: Float[Array, " G"],
    believed: Float[Array, " G"],
):
    """Mean, prior variance and root for the likeliest candidate: marginal likelihood times prior.

    What is found relevant under one candidate changes which is the likeliest: a few rounds settle both.
    """
    n = jnp.maximum(jnp.sum(filled), 1)
    square = jnp.sum(g**2) / n
    least = jnp.where(square > 0, 1e-12 * square, 1.0)  # in the judge's unit, whatever that is

    def candidate(prior: Float[Array, " D"], noise: Scalar, log_prior: Scalar):
        K = (Psi * prior[None]) @ Psi.T
        level = jnp.where(jnp.trace(K) > 0, jnp.trace(K) / n, 1.0)  # what the prior expects of g²
        K = K + jnp.diag(jnp.where(filled, noise * level, 1.0))
        L = jnp.linalg.cholesky(K)
        G_g = jax.scipy.linalg.cho_solve((L, True), g)
        scale = jnp.maximum(g @ G_g / n, least)  # the overall variance, at its own optimum
        log_det = 2 * jnp.sum(jnp.where(filled, jnp.log(jnp.diag(L)), 0.0))
        return log_prior - 0.5 * (n * jnp.log(scale) + log_det), (L, G_g, scale)

    def one_round(relevance: Float[Array, " entries"], _: None):
        spread = spread_by(priors, relevance)
        score, (L, G_g, scale) = jax.vmap(candidate)(spread, noises, believed)
        best = jnp.argmax(score)
        L, G_g, scale, prior = L[best], G_g[best], scale[best], spread[best]
        half = jax.scipy.linalg.solve_triangular(L, Psi * prior[None], lower=True)
        posterior = prior * (Psi.T @ G_g), prior * scale, half * jnp.sqrt(scale)
        return relevance_of(*posterior, relevance), posterior

    even = jnp.ones(by_entry(priors).shape[1], priors.dtype)
    return jax.tree.map(lambda x: x[-1], jax.lax.scan(one_round, even, length=ROUNDS)[1])


@jax.jit
def additive_reward(T: Trajectories, features, mean, prior, root, errors: Errors) -> AdditiveReward:
    """The posterior with the range of r̂ over the steps of T."""
    r, mask = values(features, every_step(features, T), mean), T.transitions().mask
    low = jnp.min(jnp.where(mask, r, jnp.inf))
    high = jnp.max(jnp.where(mask, r, -jnp.inf))
    margin = BOX_MARGIN * (high - low)
    unit = typical_size(r, T)  # the seen range is within the box
    return AdditiveReward(unit, features, mean, prior, root, low - margin, high + margin, errors)
