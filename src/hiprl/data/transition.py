"""Transitions (s, a, s′) in batches."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Bool, Float


class Transitions(eqx.Module):
    """A fixed number of rows (s, a, s′), of which those in `mask` were seen and the others are padding."""

    s: Float[Array, "n p"]
    a: Float[Array, "n q"]
    s_next: Float[Array, "n p"]
    terminated: Bool[Array, " n"]
    """The world ended the episode with this step (running out of time is not an end)."""
    mask: Bool[Array, " n"]
