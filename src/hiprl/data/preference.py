"""A preference g(τ₁, τ₂; r) and the set P of those that were answered."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.trajectory import Trajectory
from hiprl.types import Count, Scalar


def gap(tau: Trajectory, other: Trajectory) -> Scalar:
    """g(τ, τ′; r): by how much the true return of τ exceeds that of τ′. For scripted judges only.

    Source: HIP-RL section 2, "Trajectory Preference".
    """
    return tau.true_return - other.true_return


class Preferences(eqx.Module):
    """P: answers g with the indices in T of the two trajectories compared; g > 0 means the first is better."""

    g: Float[Array, " K"]
    first: Int[Array, " K"]
    second: Int[Array, " K"]
    count: Count

    @classmethod
    def empty(cls, capacity: int) -> Preferences:
        """P = ∅ with room for `capacity` answers."""
        nobody = jnp.zeros(capacity, jnp.int32)
        return cls(jnp.zeros(capacity), nobody, nobody, jnp.zeros((), jnp.int32))

    @property
    def capacity(self) -> int:
        return self.g.shape[0]

    @property
    def filled(self) -> Bool[Array, " K"]:
        """True for the rows that hold an answer."""
        return jnp.arange(self.capacity) < self.count

    def add(self, g: Scalar, first: Count, second: Count) -> Preferences:
        """P ∪ {g(τ_first, τ_second)}. The caller sees to it that there is room."""
        return Preferences(
            self.g.at[self.count].set(g),
            self.first.at[self.count].set(first),
            self.second.at[self.count].set(second),
            self.count + 1,
        )
