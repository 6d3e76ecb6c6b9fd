"""A trajectory τ, padded to the horizon."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from hiprl.data.transition import Transitions
from hiprl.errors import InputError
from hiprl.types import Count, Flag, Scalar


class Trajectory(eqx.Module):
    """τ = (s_0, a_0, …, s_H) as it was executed, or imagined: at most H actions, then padding.

    The paper's τ ends with a_{H-1}; s_H is kept as well, since a fall is seen in no other state.
    """

    states: Float[Array, "H_plus_1 p"]
    actions: Float[Array, "H q"]
    """Each entry in [-1, 1]; the world scales them to its own bounds."""
    rewards: Float[Array, " H"]
    """What the environment paid, or would; NaN where nothing. For scripted judges and reports, never for learning."""
    length: Count
    """How many actions were executed."""
    terminated: Flag
    """The world ended the episode; False when time ran out."""
    imagined: Flag = eqx.field(default=False, converter=jnp.asarray)
    """Nobody executed it: it is what a policy does in the model."""

    @property
    def steps(self) -> Bool[Array, " H"]:
        """True where an action was executed."""
        return jnp.arange(self.actions.shape[0]) < self.length

    @property
    def true_return(self) -> Scalar:
        """Sum of what the environment paid. For scripted judges and reports only."""
        return jnp.sum(jnp.where(self.steps, self.rewards, 0.0))

    def transitions(self) -> Transitions:
        """(s, a, s′) of each step, padding masked and set to zero."""
        steps = self.steps
        clean_s = jnp.where(jnp.arange(self.states.shape[0])[:, None] <= self.length, self.states, 0.0)
        return Transitions(
            s=jnp.where(steps[:, None], clean_s[:-1], 0.0),
            a=jnp.where(steps[:, None], self.actions, 0.0),
            s_next=jnp.where(steps[:, None], clean_s[1:], 0.0),
            terminated=steps & (jnp.arange(steps.shape[0]) == self.length - 1) & self.terminated,
            mask=steps,
        )

    def cut(self, start: Count, length: Count) -> Trajectory:
        """At most `length` steps from step `start`, as a trajectory of their own; it ends where this one does."""
        start = jnp.clip(start, 0, self.length)
        n = jnp.minimum(length, self.length - start)
        rolled = lambda x: jnp.roll(x, -start, axis=0)
        ended = self.terminated & (start + n == self.length) & (n > 0)
        steps = rolled(self.states), rolled(self.actions), rolled(self.rewards)
        return Trajectory(*steps, n.astype(jnp.int32), ended, self.imagined)

    def seen(self) -> Trajectory:
        """The same without padding, as NumPy arrays: what a judge gets."""
        n = int(self.length)
        return eqx.tree_at(
            lambda tau: (tau.states, tau.actions, tau.rewards, tau.length, tau.terminated, tau.imagined),
            self,
            (
                np.asarray(self.states)[: n + 1],
                np.asarray(self.actions)[:n],
                np.asarray(self.rewards)[:n],
                np.asarray(self.length),
                np.asarray(self.terminated),
                np.asarray(self.imagined),
            ),
        )


def trajectory_from(
    states: ArrayLike,
    actions: ArrayLike,
    *,
    H: int,
    terminated: bool,
    rewards: ArrayLike | None = None,
    imagined: bool = False,
) -> Trajectory:
    """A trajectory from what was recorded: one state more than actions, at most `H` actions.

    Raises:
        InputError: the shapes do not fit each other, or a value is not finite.
    """
    try:
        states, actions = np.asarray(states, np.float32), np.asarray(actions, np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"got states and actions that are no arrays of numbers ({error}); a trajectory needs (n + 1, p) and "
            "(n, q). Record the state before each action and the last one, each with the same entries."
        ) from error
    n = actions.shape[0] if actions.ndim else 0
    if states.ndim != 2 or actions.ndim != 2 or states.shape[0] != n + 1 or not 1 <= n <= H:
        raise InputError(
            f"got states of shape {states.shape} and actions of shape {actions.shape}; a trajectory needs "
            f"(n + 1, p) and (n, q) with 1 <= n <= H = {H}. Record the state before each action and the last one."
        )
    if not (np.isfinite(states).all() and np.isfinite(actions).all()):
        raise InputError(
            "got a trajectory with values that are not finite; states and actions must be real numbers. "
            "Cut the trajectory before the first NaN or infinity."
        )
    paid = np.full(n, np.nan, np.float32) if rewards is None else np.asarray(rewards, np.float32)
    if paid.shape != (n,):
        raise InputError(
            f"got rewards of shape {paid.shape} for {n} actions; one reward an action is needed. "
            "Leave rewards out if the environment gives none."
        )
    pad = H - n
    return Trajectory(
        states=jnp.asarray(np.pad(states, ((0, pad), (0, 0)))),
        actions=jnp.asarray(np.pad(actions, ((0, pad), (0, 0)))),
        rewards=jnp.asarray(np.pad(paid, (0, pad))),
        length=jnp.asarray(n, jnp.int32),
        terminated=jnp.asarray(terminated),
        imagined=jnp.asarray(imagined),
    )
