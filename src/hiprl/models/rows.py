"""Drawing rows from those that a mask lets through."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Int

from hiprl.types import Count, Key


class RowDraw(eqx.Module):
    """Draws row numbers uniformly from those where a mask is True, without a loop or a changing shape."""

    order: Int[Array, " n"]
    """The rows of the mask first."""
    count: Count

    @classmethod
    def of(cls, mask: Bool[Array, " n"]) -> RowDraw:
        return cls(jnp.argsort(~mask, stable=True), jnp.sum(mask))

    def __call__(self, key: Key, shape: tuple[int, ...]) -> Int[Array, "..."]:
        """Row numbers in this shape; row 0 of the order where the mask lets nothing through."""
        return self.order[jr.randint(key, shape, 0, jnp.maximum(self.count, 1))]
