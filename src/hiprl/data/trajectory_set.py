"""The set T of trajectories: a capacity, a count, and padding past the count."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.preference import Clip
from hiprl.data.trajectory import Trajectory
from hiprl.data.transition import Transitions
from hiprl.types import Count


class Trajectories(eqx.Module):
    """T, in the order of execution, and what was imagined on the way. Its shapes never change: nothing recompiles."""

    rows: Trajectory
    """A stack of `capacity` trajectories."""
    count: Count

    @classmethod
    def empty(cls, capacity: int, *, H: int, p: int, q: int) -> Trajectories:
        """T = ∅ with room for `capacity` trajectories of at most `H` steps."""
        blank = Trajectory(
            states=jnp.zeros((H + 1, p)),
            actions=jnp.zeros((H, q)),
            rewards=jnp.zeros(H),
            length=jnp.zeros((), jnp.int32),
            terminated=jnp.zeros((), bool),
            imagined=jnp.zeros((), bool),
        )
        return cls(jax.tree.map(lambda x: jnp.zeros((capacity, *x.shape), x.dtype), blank), jnp.zeros((), jnp.int32))

    @property
    def capacity(self) -> int:
        return self.rows.length.shape[0]

    @property
    def filled(self) -> Bool[Array, " N"]:
        """True for the rows that hold a trajectory."""
        return jnp.arange(self.capacity) < self.count

    @property
    def real(self) -> Bool[Array, " N"]:
        """True for the rows that hold a trajectory which was executed."""
        return self.filled & ~self.rows.imagined

    @property
    def last(self) -> Count:
        """Index of the newest trajectory."""
        return self.count - 1

    @jax.jit
    def add(self, tau: Trajectory) -> Trajectories:
        """T ∪ {τ}. The caller sees to it that there is room."""
        rows = jax.tree.map(lambda all_, one: all_.at[self.count].set(one), self.rows, tau)
        return Trajectories(rows, self.count + 1)

    @jax.jit
    def executed(self) -> Trajectories:
        """The same with no steps in what was only imagined: what the world is learned from."""
        length = jnp.where(self.rows.imagined, 0, self.rows.length)
        return eqx.tree_at(lambda T: T.rows.length, self, length)

    @jax.jit
    def get(self, i: Int[Array, ""] | int) -> Trajectory:
        """Trajectory number `i`, from 0."""
        return jax.tree.map(lambda all_: all_[i], self.rows)

    @jax.jit
    def clip(self, clip: Clip) -> Trajectory:
        """What a clip shows."""
        return self.get(clip.of).cut(clip.start, clip.length)

    def transitions(self) -> Transitions:
        """All steps of all trajectories in one batch of capacity * H rows, padding masked."""
        per_trajectory = jax.vmap(Trajectory.transitions)(self.rows)
        mask = per_trajectory.mask & self.filled[:, None]
        flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), per_trajectory)
        return eqx.tree_at(lambda rows: rows.mask, flat, mask.reshape(-1))

    def seen(self) -> Bool[Array, "N H_plus_1"]:
        """True for the states that were visited, the last one of each trajectory included."""
        t = jnp.arange(self.rows.states.shape[1])
        return self.filled[:, None] & (t[None] <= self.rows.length[:, None])

    def first_states(self) -> Float[Array, "N p"]:
        """s_0 of each executed trajectory, over and over: a row drawn uniformly is as likely any of them."""
        executed = jnp.argsort(~self.real, stable=True)  # these first
        turn = jnp.arange(self.capacity) % jnp.maximum(jnp.sum(self.real), 1)
        return self.rows.states[executed[turn], 0]

    @partial(jax.jit, static_argnames=("margin",))
    def box(
        self, *, margin: float, also: Float[Array, "n p"] | None = None
    ) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Least and greatest of each entry of the states seen and of `also`, widened by a share of their distance."""
        seen, states = self.seen()[..., None], self.rows.states
        low = jnp.min(jnp.where(seen, states, jnp.inf), axis=(0, 1))
        high = jnp.max(jnp.where(seen, states, -jnp.inf), axis=(0, 1))
        if also is not None:
            low, high = jnp.minimum(low, also.min(axis=0)), jnp.maximum(high, also.max(axis=0))
        return low - margin * (high - low), high + margin * (high - low)
