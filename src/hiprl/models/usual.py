"""How much each step that was seen counts: one that is far worse than most would outweigh them all.

An episode in which a policy drove the world far away has rewards a thousand times as large as any other. The unit of
r̂ would be theirs, and imagined rollouts from there all that the value fits and that the policy's gradient goes by.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from hiprl.data.trajectory_set import Trajectories
from hiprl.models.sums import evenly
from hiprl.types import Scalar

FAR = 5.0  # spreads of a usual trajectory below the middle, where a step counts half


def counts(r: Float[Array, " steps"], T: Trajectories) -> Float[Array, " steps"]:
    """1 for a usual step, next to 0 for one that is far worse than most by r̂, and 0 for padding.

    Middle and spread are medians, over steps and over trajectories, so that a few of either do not change them.
    """
    mask = T.transitions().mask
    some, there = evenly(mask)  # to sort them all would take longer than the rest of a refit
    middle = jnp.nanmedian(jnp.where(there, r[some], jnp.nan))
    off = jnp.where(mask, r - middle, 0.0)
    square = jnp.sum((off**2).reshape(T.capacity, -1), axis=1) / jnp.maximum(T.rows.length, 1)
    spread = jnp.sqrt(jnp.nanmedian(jnp.where(T.filled & (T.rows.length > 0), square, jnp.nan)))
    short = jnp.maximum(-off, 0.0) / jnp.where(spread > 0, FAR * spread, 1.0)
    return jnp.where(mask, 1 / (1 + short**4), 0.0)


def typical_size(r: Float[Array, " steps"], T: Trajectories) -> Scalar:
    """Root mean square of r̂ over the steps of T, each as much as it counts; 1 where r̂ is zero everywhere."""
    weight = counts(r, T)
    square = jnp.sum(weight * jnp.where(weight > 0, r, 0.0) ** 2) / jnp.maximum(jnp.sum(weight), 1e-6)
    return jnp.where(square > 0, jnp.sqrt(square), 1.0)
