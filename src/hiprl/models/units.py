"""The unit in which an answer's level is read: the spread of r̂ over the clips that were at hand when it was asked for.

What is much better among stumbles is nothing among runs.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hiprl.data.preference import Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.types import Count

STARTS = 32  # clips of a trajectory over which its spread is taken
LEAST_UNIT = 1e-3  # of an answer, in that of the one whose unit is 1


def lengths_of(P: Preferences) -> Int[Array, " L"]:
    """Each length that first clips have, once, and some twice, so that few programs serve all. Not to be traced."""
    lengths = np.unique(np.asarray(P.clips.length[:, 0]))
    return jnp.asarray(np.resize(lengths, 1 << (len(lengths) - 1).bit_length()))


def units(
    r: Float[Array, "N H"], T: Trajectories, P: Preferences, lengths: Int[Array, " L"], newest: Count
) -> Float[Array, " K"]:
    """Spread of r̂ over the clips at hand at each answer, over that at one of them.

    Args:
        r: r̂ at each step.
        T: the trajectories.
        P: the answers.
        lengths: what `lengths_of` gives.
        newest: index of the answer whose unit is 1.
    """
    found = spreads(r, T, P, lengths)
    one = found[newest]
    return jnp.where(one > 0, jnp.maximum(found / one, LEAST_UNIT), 1.0)


def spreads(r: Float[Array, "N H"], T: Trajectories, P: Preferences, lengths: Int[Array, " L"]) -> Float[Array, " K"]:
    """Standard deviation of r̂ over the clips at hand at each answer, in the unit of r̂."""
    real = jax.vmap(Trajectory.transitions)(T.rows).mask
    C = jnp.pad(jnp.cumsum(jnp.where(real, r, 0.0), axis=1), ((0, 0), (1, 0)))
    i = jnp.arange(T.capacity)
    there = ((i[None] < P.at_hand[:, None]) & T.filled[None]).astype(r.dtype)
    count = STARTS * jnp.maximum(jnp.sum(there, axis=1), 1)

    def spread(length: Count) -> Float[Array, " K"]:
        n = jnp.minimum(length, T.rows.length)[:, None]
        latest = T.rows.length[:, None] - n
        t = (latest * jnp.arange(STARTS)[None]) // (STARTS - 1)
        shown = jnp.where(T.filled[:, None], C[i[:, None], t + n] - C[i[:, None], t], 0.0)
        own = jnp.mean(shown, axis=1)  # of each trajectory
        within = jnp.sum((shown - own[:, None]) ** 2, axis=1)
        middle = STARTS * (there @ own) / count
        between = jnp.sum(there * (own[None] - middle[:, None]) ** 2, axis=1)
        return jnp.sqrt((there @ within + STARTS * between) / count)

    which = jnp.argmax(lengths[None] == P.clips.length[:, :1], axis=1)
    return jax.lax.map(spread, lengths)[which, jnp.arange(P.capacity)]
