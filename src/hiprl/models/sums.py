"""r̂ and sums of φ over many steps at once, with the values of each coordinate side by side in memory.

The same as `AdditiveFeatures` says of one step after the other, in an order of computation that is several times as
fast: the steps are the innermost axis, and features are never written out.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.trajectory_set import Trajectories
from hiprl.models.features import AdditiveFeatures, by_entry, functions, turn_of, waves

Scale = TypeVar("Scale", bound=eqx.Module)
MANY = 4096  # steps over which a mean or a median is taken where there are more


class Steps(NamedTuple):
    """All steps that T has room for, one trajectory after the other."""

    x: Float[Array, "n steps"]
    """(s, a) of each, every entry a row; 0 where there is no step."""
    mask: Bool[Array, " steps"]
    executed: Bool[Array, " steps"]
    """The same but for those that were only imagined."""


@jax.jit
def steps_of(T: Trajectories) -> Steps:
    """The steps of T."""
    rows = T.transitions()
    clean = lambda x: jnp.where(rows.mask[:, None], x, 0.0)
    real = jnp.repeat(T.real, T.rows.actions.shape[1])
    return Steps(side_by_side(clean(rows.s), clean(rows.a)), rows.mask, rows.mask & real)


def side_by_side(s: Float[Array, "steps p"], a: Float[Array, "steps q"]) -> Float[Array, "n steps"]:
    """(s, a) of steps, each entry a row."""
    x = jax.lax.optimization_barrier(jnp.concatenate([s, a], axis=1))  # to turn the whole is faster than its parts
    return jax.lax.optimization_barrier(x.T)  # or who uses it would put it together anew


def evenly(mask: Bool[Array, " steps"], most: int = MANY) -> tuple[Int[Array, " most"], Bool[Array, " most"]]:
    """Indices of at most `most` steps where the mask is true, from everywhere among them, and which ones are that."""
    k = min(most, mask.shape[0])
    count = jnp.sum(mask)
    n = jnp.minimum(count, k)
    i = jnp.arange(k)
    nth = (i * (count / jnp.maximum(n, 1))).astype(jnp.int32)  # whole numbers would overflow
    at = jnp.searchsorted(jnp.cumsum(mask), 1 + nth)
    return jnp.minimum(at, mask.shape[0] - 1), i < n


@jax.jit
def columns(features: AdditiveFeatures, x: Float[Array, "n steps"]) -> Float[Array, "n steps"]:
    """Coordinates of steps, each coordinate a row."""
    z = by_row(features.scaler).down(x)
    return jax.lax.optimization_barrier(jnp.clip(z, features.low[:, None], features.high[:, None]))


def terms(features: AdditiveFeatures, X: Float[Array, "n steps"]) -> list[Float[Array, "n steps"]]:
    """φ but for the bias: the coordinates themselves, their squares and their waves by frequency, each with mean 0.

    The means go before anything is added up: float32 has few digits to spare.
    """
    centres = by_entry(features.centre)
    raw = [X, X**2, *waves(by_row(features.fine)(X).reshape(-1))]
    return [x.reshape(X.shape) - centres[:, m, None] for m, x in enumerate(raw)]


def by_row(scale: Scale) -> Scale:
    """The same for values of which each entry is a row."""
    return jax.tree.map(lambda x: x[:, None], scale)


def values(
    features: AdditiveFeatures, X: Float[Array, "n steps"], weights: Float[Array, " D"]
) -> Float[Array, " steps"]:
    """φᵀ weights at each step."""
    return added_up(features, functions(X, by_row(features.fine), by_entry(weights).T[..., None]), weights)


def added_up(
    features: AdditiveFeatures, each: Float[Array, "n steps"], weights: Float[Array, " D"]
) -> Float[Array, " steps"]:
    """φᵀ weights from the function of each coordinate."""
    # the means go before anything is added up, as in `terms`
    middle = jnp.sum(by_entry(weights) * by_entry(features.centre), axis=1)[:, None]
    return weights[0] + jnp.ones(each.shape[0], each.dtype) @ (each - middle)


@jax.jit
def turns(features: AdditiveFeatures, X: Float[Array, "n steps"]) -> Float[Array, "n steps"]:
    """Of the waves at each coordinate: all of `values` that does not depend on the weights, and half of its time."""
    return turn_of(by_row(features.fine)(X))


def total(features: AdditiveFeatures, X: Float[Array, "n steps"], shown: Bool[Array, " steps"]) -> Float[Array, " D"]:
    """Sum of φ over the steps shown. Best a clip at a time, whose waves stay near the processor."""
    one = jnp.where(shown, 1.0, 0.0).astype(X.dtype)
    straight, square, *smooth = (jnp.where(shown[None], term, 0.0) @ one for term in terms(features, X))
    return jnp.concatenate([jnp.sum(one)[None], straight, square, jnp.stack(smooth, axis=1).reshape(-1)])
