"""The policies that were executed, from which a search can start again when the newest one went wrong."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hiprl.control.imagined import SearchState
from hiprl.types import Count


class Archive(eqx.Module):
    """The search behind each trajectory of T, in the same rows; random and imagined ones have none."""

    states: SearchState
    """A stack of `capacity` searches."""
    filled: Bool[Array, " N"]

    @classmethod
    def empty(cls, capacity: int, blank: SearchState) -> Archive:
        """No policy was executed yet: each row holds the search that knows nothing."""
        stack = jax.tree.map(lambda x: jnp.broadcast_to(x, (capacity, *x.shape)), blank)
        return cls(stack, jnp.zeros(capacity, bool))

    @jax.jit
    def put(self, i: Count, state: SearchState) -> Archive:
        """The archive with `state` as the search behind trajectory `i`."""
        stack = jax.tree.map(lambda all_, one: all_.at[i].set(one), self.states, state)
        return Archive(stack, self.filled.at[i].set(True))

    @jax.jit
    def get(self, i: Count | int) -> SearchState:
        """The search behind trajectory `i`."""
        return jax.tree.map(lambda all_: all_[i], self.states)

    @jax.jit
    def best(self, returns: Float[Array, " N"]) -> Count:
        """The row whose executed trajectory has the greatest of these returns, by the newest r̂."""
        return jnp.argmax(jnp.where(self.filled, returns, -jnp.inf)).astype(jnp.int32)
