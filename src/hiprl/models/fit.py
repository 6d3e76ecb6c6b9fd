"""The one jitted minibatch loop, which keeps what is best on held-out data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
import jax.random as jr
import optax

from hiprl.types import Count, Key, Scalar

Params = TypeVar("Params")


def descent(optimiser: optax.GradientTransformation, params: Any) -> Any:
    """The state of an optimiser before its first step."""
    return optimiser.init(params)


def descend(
    optimiser: optax.GradientTransformation, params: Params, gradient: Params, state: Any
) -> tuple[Params, Any]:
    """One step of an optimiser: the new parameters and its new state."""
    # optax's own type for parameters knows no modules
    updates, state = optimiser.update(cast(Any, gradient), state, cast(Any, params))
    return cast(Params, optax.apply_updates(cast(Any, params), updates)), state


class FitReport(NamedTuple):
    """How a fit went; the host looks at it and raises where it must."""

    loss: Scalar
    """Held-out loss of the parameters that were kept."""
    steps: Count
    """Gradient steps taken."""


def fit(
    params: Params,
    train_loss: Callable[[Params, Key], Scalar],
    held_out_loss: Callable[[Params], Scalar],
    optimiser: optax.GradientTransformation,
    *,
    chunk: int,
    chunks: int | Count,
    key: Key,
) -> tuple[Params, FitReport]:
    """Steps on `train_loss` (which draws its own minibatch), in chunks; keeps what has the least `held_out_loss`.

    It does not end before, however long nothing gets better: while a rate still rises, all gets worse for a while.

    Args:
        params: where to start. Every array in it is trained.
        train_loss: loss on a minibatch drawn with the key it gets.
        held_out_loss: judged after each chunk; the parameters with the least are kept.
        optimiser: an optax transformation.
        chunk: gradient steps between two looks at the held-out loss.
        chunks: how many; may be traced.
    """

    def step(carry: tuple[Params, Any], step_key: Key):
        params, opt_state = carry
        gradient = jax.grad(train_loss)(params, step_key)
        return descend(optimiser, params, gradient, opt_state), None

    def one_chunk(_number: Count, state: Any):
        params, opt_state, best, best_loss, steps, key = state
        key, chunk_key = jr.split(key)
        (params, opt_state), _ = jax.lax.scan(step, (params, opt_state), jr.split(chunk_key, chunk))
        loss = held_out_loss(params)
        better = loss < best_loss
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), params, best)
        return params, opt_state, best, jnp.where(better, loss, best_loss), steps + chunk, key

    start = params, descent(optimiser, params), params, jnp.asarray(jnp.inf), jnp.zeros((), jnp.int32), key
    _, _, best, best_loss, steps, _ = jax.lax.fori_loop(0, chunks, one_chunk, start)
    return best, FitReport(loss=best_loss, steps=steps)
