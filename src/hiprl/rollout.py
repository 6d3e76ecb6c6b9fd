"""Trajectories drawn from a dynamics and an actor, and what they are worth under a reward."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import jax.random as jr

from hiprl.data.trajectory import Trajectory
from hiprl.types import Action, Actor, Flag, Key, Scalar, State


def roll_out(
    f: Callable[[State, Action, Key], State],
    actor: Actor,
    s_0: State,
    *,
    H: int,
    r: Callable[[State, Action], Scalar],
    terminates: Callable[[State, Action, State], Flag] | None = None,
    key: Key,
) -> Trajectory:
    """τ ~ (f, π): `H` steps of `actor` in `f` from `s_0`, cut where `terminates` says so.

    `f` maps (s, a, key) to the next state, noise included. After an end the scan goes on from a frozen
    state, and what it gives there is padding.
    """

    def step(carry: tuple[State, Flag, Key], _: None):
        s, alive, key = carry
        key, act_key, f_key = jr.split(key, 3)
        a = actor.act(s, key=act_key)
        s_next = jnp.where(alive, f(s, a, f_key), s)
        ended = alive & (terminates(s, a, s_next) if terminates is not None else jnp.asarray(False))
        return (s_next, alive & ~ended, key), (s_next, a, r(s, a), alive)

    (_, alive, _), (s_next, actions, rewards, executed) = jax.lax.scan(step, (s_0, jnp.asarray(True), key), length=H)
    return Trajectory(
        states=jnp.concatenate([s_0[None], s_next]),
        actions=actions,
        rewards=rewards,
        length=jnp.sum(executed).astype(jnp.int32),
        terminated=~alive,
    )


def J(tau: Trajectory, r: Callable[[State, Action], Scalar]) -> Scalar:
    """Sum of r over the executed steps of τ: one draw of J(f, π), eq. (4)."""
    steps = tau.steps
    s = jnp.where(steps[:, None], tau.states[:-1], 0.0)
    a = jnp.where(steps[:, None], tau.actions, 0.0)
    return jnp.sum(jnp.where(steps, jax.vmap(r)(s, a), 0.0))
