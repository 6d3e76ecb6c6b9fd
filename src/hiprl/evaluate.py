"""What a policy is worth in the world, and means and intervals over seeds. For reports only, never for learning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.random as jr
import numpy as np

from hiprl.data.trajectory import Trajectory
from hiprl.types import Actor, Key
from hiprl.world.task import World


def episodes(world: World, actor: Actor, n: int, *, key: Key) -> list[Trajectory]:
    """`n` episodes of the actor, each from a start of its own."""
    return [world.roll_out(actor, key=episode_key) for episode_key in jr.split(key, n)]


def true_returns(taus: Sequence[Trajectory]) -> np.ndarray:
    """The return of each by what the environment paid; NaN where it paid nothing."""
    return np.array([float(tau.true_return) for tau in taus])


class Interval(NamedTuple):
    """A mean over runs and where it may lie."""

    mean: float
    """Interquartile mean: of the middle half of the runs."""
    low: float
    high: float


def interquartile_mean(x: np.ndarray) -> float:
    """Mean of the middle half; the runs at its edge count by the share of them that lies inside.

    Source: Agarwal et al. (2021), "Deep RL at the edge of the statistical precipice".
    """
    x = np.sort(np.asarray(x, float))
    n = len(x)
    edges = np.arange(n + 1) / n
    weight = np.clip(np.minimum(edges[1:], 0.75) - np.maximum(edges[:-1], 0.25), 0, None)
    return float(x @ weight / weight.sum())


def interval(x: Sequence[float] | np.ndarray, *, level: float = 0.95, draws: int = 2000, seed: int = 0) -> Interval:
    """Interquartile mean of the runs with its bootstrap interval (runs drawn again with replacement)."""
    values = np.asarray(x, float)
    rng = np.random.default_rng(seed)
    again = rng.choice(values, (draws, len(values)))
    means = np.array([interquartile_mean(row) for row in again])
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return Interval(interquartile_mean(values), float(low), float(high))


def cumulative_regret(optimal_return: float, returns: Sequence[float] | np.ndarray) -> np.ndarray:
    """Reg(k) = Σ reg(i), eq. (3), against a known optimal return."""
    return np.cumsum(optimal_return - np.asarray(returns, float))
