"""A world made of a task in pure JAX: one compiled program an episode."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr

from hiprl.data.trajectory import Trajectory
from hiprl.errors import WorldError
from hiprl.rollout import roll_out
from hiprl.types import Actor, Key
from hiprl.world.task import Task, World
from hiprl.world.termination import never


class JaxWorld(World):
    """Executes actors in a task; `spec` is the text it was made from, if any."""

    def __init__(self, task: Task, *, horizon: int | None = None, spec: str | None = None):
        self.task = task
        self.name, self.p, self.q = task.name, task.p, task.q
        self.H = task.H if horizon is None else horizon
        self.ends = task.ends
        self.anywhere = task.anywhere()
        # A bound method of a module with arrays has no hash; this function has one and can be a static
        # argument.
        self.terminates = (lambda s, a, s_next: task.terminates(s, a, s_next)) if task.ends else never
        self._spec = spec

    def roll_out(self, actor: Actor, *, key: Key) -> Trajectory:
        tau, finite = _episode(self.task, actor, key, H=self.H)
        if not finite:
            raise WorldError(
                f"{self.name} gave a state or a reward that is not finite; a world must stay within real "
                "numbers. Look at the task's f and r for what grows without bound, or give it a shorter "
                "horizon."
            )
        return tau

    prices = True

    def priced(self, tau: Trajectory) -> Trajectory:
        return eqx.tree_at(lambda tau: tau.rewards, tau, jax.vmap(self.task.r)(tau.states[:-1], tau.actions))

    def spec(self) -> str | None:
        return self._spec


@partial(jax.jit, static_argnames="H")
def _episode(task: Task, actor: Actor, key: Key, *, H: int):
    """An episode, and whether all its states and rewards are finite."""
    first_key, steps_key = jr.split(key)
    tau = roll_out(
        task.f,
        actor,
        task.s_0(first_key),
        H=H,
        r=task.r,
        terminates=task.terminates if task.ends else None,
        key=steps_key,
    )
    return tau, jnp.all(jnp.isfinite(tau.states)) & jnp.all(jnp.isfinite(tau.rewards))
