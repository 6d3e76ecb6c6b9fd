"""How good a learned reward is, without the truth: what it says of answers that were kept from it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hiprl.data.preference import Kind, Preferences, Said
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.answers import KAPPA, MISTAKE
from hiprl.models.estimate import RewardConfig, estimate_reward
from hiprl.models.evidence import Evidence, evidence
from hiprl.models.likelihood import Noise, log_likelihood
from hiprl.models.reward import JUDGES, AdditiveReward
from hiprl.models.units import lengths_of, spreads, units
from hiprl.types import Scalar

TINY = 1e-30
DRAWS = 512  # from the belief about a held-out answer
NUMBER_VAR = 1e-4  # of a number's error, over the mean square of all numbers: a hundredth of their size


class Held(NamedTuple):
    """What was predicted of each answer by a reward that had not seen it."""

    right: Float[Array, " K"]
    """1 where the better clip, or the best of a ranking, was told; 0 where not; NaN where the answer names none."""
    log_likelihood: Float[Array, " K"]
    """Of the answer, in nats; a number's density is in units of the root mean square of all numbers."""
    covered: Float[Array, " K"]
    """1 where a number lay in its 90 % interval; NaN for what is no number."""

    def mean(self, name: str) -> float | None:
        """Mean of one of these over the answers for which it means something; None if there are none."""
        values = np.asarray(getattr(self, name))
        known = values[np.isfinite(values)]
        return float(known.mean()) if len(known) else None


def cross_validated(P: Preferences, T: Trajectories, config: RewardConfig, *, folds: int = 10) -> Held:
    """Each answer predicted from those of the other folds.

    Args:
        P: the answers.
        T: the trajectories they are about.
        config: how the reward is estimated.
        folds: into how many parts the answers are put; at most one an answer.
    """
    n = int(P.count)
    held = np.full((3, P.capacity), np.nan)
    folds = min(folds, n)
    for fold in range(folds if n > 1 else 0):
        out = np.arange(n) % folds == fold
        kept = P.only(np.flatnonzero(~out))
        reward = estimate_reward(kept, T, None, config)
        assert isinstance(reward, AdditiveReward)
        found = np.stack([np.asarray(x) for x in predicted(P, T, reward, newest=int(np.flatnonzero(~out).max()))])
        held[:, :n][:, out] = found[:, :n][:, out]
    return Held(*map(jnp.asarray, held))


def predicted(P: Preferences, T: Trajectories, reward: AdditiveReward, *, newest: int) -> Held:
    """What a reward says of each answer in P; `newest` is the index of the newest one that it has learned from."""
    return _predicted(P, T, reward, evidence(T, P), lengths_of(P), jnp.asarray(newest))


@jax.jit
def _predicted(P: Preferences, T: Trajectories, reward: AdditiveReward, seen: Evidence, lengths, newest) -> Held:
    Psi, J = seen.Psi, seen.Psi.shape[1]
    mean = Psi @ reward.mean
    half = Psi @ reward.root.T
    C = jnp.einsum("kid,d,kjd->kij", Psi, reward.prior, Psi) - jnp.einsum("kin,kjn->kij", half, half)
    L = jnp.linalg.cholesky(C + (TINY + 1e-6 * jnp.trace(C, axis1=1, axis2=2))[:, None, None] * jnp.eye(J)[None])
    z = jnp.asarray(np.random.default_rng(0).normal(size=(DRAWS, J)), jnp.float32)
    draws = mean[:, None] + jnp.einsum("kij,nj->kni", L, z)  # of the differences, in the unit of r̂
    number = P.said.kind == Kind.NUMBER
    numbers = P.filled & number
    count = jnp.maximum(jnp.sum(numbers), 1)
    size = jnp.sqrt(jnp.sum(jnp.where(numbers, P.g**2, 0.0)) / count)
    size = jnp.where(size > 0, size, 1.0)
    r = seen.values(reward.mean).reshape(T.rows.actions.shape[:2])
    knows = reward.errors.kappa < 1  # what a whole scale is; a reward of numbers alone takes the spread of r̂ for it
    whole = jnp.maximum(spreads(r, T, P, lengths)[newest], TINY)
    scale = jnp.where(knows, reward.errors.scale, 1 / whole) / units(r, T, P, lengths, newest)
    kappa = jnp.where(knows, reward.errors.kappa, KAPPA)
    mistakes = jnp.where(knows, reward.errors.mistakes[jnp.minimum(P.judge, JUDGES - 1)], MISTAKE)

    def one(draws: Float[Array, "n J"], said: Said, mistake: Scalar) -> Scalar:
        noise = Noise(kappa, jnp.asarray(NUMBER_VAR), mistake)
        each = jax.vmap(lambda u: log_likelihood(u, said, noise))(draws)
        return jax.nn.logsumexp(each) - jnp.log(DRAWS)

    var = C[:, 0, 0] / size**2 + NUMBER_VAR
    of_number = -0.5 * ((P.g - mean[:, 0]) / size) ** 2 / var - 0.5 * jnp.log(2 * jnp.pi * var)
    value = jnp.where(number, of_number, jax.vmap(one)(draws * scale[:, None, None], P.said, mistakes))
    low, high = P.said.low, P.said.high
    above, below = low > -high, -high > low  # of 0, on the whole; either end may be infinite
    sign = above.astype(jnp.float32) - below.astype(jnp.float32)
    ranked = P.said.kind == Kind.RANKING
    used = jnp.arange(J)[None] < P.said.items[:, None] - 1
    best_first = (mean[:, 0] > 0) & jnp.all(jnp.where(used, mean[:, :1] >= mean, True), axis=1)
    right = jnp.where(ranked, best_first, sign * mean[:, 0] > 0).astype(jnp.float32)
    none = ~P.filled | (~ranked & (sign == 0))  # equal, or cannot tell
    width = jnp.sqrt(jnp.maximum(C[:, 0, 0], 0.0))
    covered = (jnp.abs(P.g - mean[:, 0]) <= 1.6449 * width).astype(jnp.float32)
    return Held(
        jnp.where(none, jnp.nan, right),
        jnp.where(P.filled, value, jnp.nan),
        jnp.where(numbers, covered, jnp.nan),
    )


class Shape(NamedTuple):
    """What r̂ makes of one coordinate of (s, a), all else as it is on average."""

    x: Float[Array, " points"]
    """Values of the coordinate, over what was seen."""
    mean: Float[Array, " points"]
    """Reward a step, in the unit of r̂, against the middle of what was seen."""
    std: Float[Array, " points"]
    """Of the belief about it."""
    weight: Float[Array, ""]
    """How much of the spread of r̂ over the steps seen goes through this coordinate: a standard deviation."""


def shapes(reward: AdditiveReward, T: Trajectories, *, points: int = 61) -> Shape:
    """What the posterior mean rewards, coordinate by coordinate of (s, a), stacked; over what was executed."""
    return _shapes(reward, T.executed(), jnp.linspace(0.02, 0.98, points))


@jax.jit
def _shapes(reward: AdditiveReward, T: Trajectories, shares: Float[Array, " points"]) -> Shape:
    rows = T.transitions()
    x = jnp.concatenate([rows.s, rows.a], axis=1)
    p, n = rows.s.shape[1], x.shape[1]
    # quantiles over what was seen: past the mask sorts last
    ranked = jnp.sort(jnp.where(rows.mask[:, None], x, jnp.inf), axis=0)
    count = jnp.maximum(jnp.sum(rows.mask), 1)
    at = lambda share: ranked[jnp.clip((share * count).astype(jnp.int32), 0, count - 1)]
    low, high, middle = at(jnp.asarray(0.005)), at(jnp.asarray(0.995)), at(jnp.asarray(0.5))

    def one(j):
        grid = low[j] + shares * (high[j] - low[j])
        put = lambda value: middle.at[j].set(value)
        phi = jax.vmap(lambda value: reward.features(put(value)[:p], put(value)[p:]))(grid)
        phi = phi - reward.features(middle[:p], middle[p:])[None]
        half = phi @ reward.root.T
        var = jnp.sum(phi**2 * reward.prior[None], axis=1) - jnp.sum(half**2, axis=1)
        seen = jnp.where(rows.mask, jnp.interp(x[:, j], grid, phi @ reward.mean), 0.0)
        mean = jnp.sum(seen) / count
        spread = jnp.sqrt(jnp.sum(jnp.where(rows.mask, (seen - mean) ** 2, 0.0)) / count)
        return Shape(grid, phi @ reward.mean, jnp.sqrt(jnp.maximum(var, 0.0)), spread)

    return jax.lax.map(one, jnp.arange(n))
