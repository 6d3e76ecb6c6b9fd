"""A run whose reward is known: what is left is to explore the world. Nobody is asked anything."""

from __future__ import annotations

import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from benchmarks.common import progress
from hiprl.algorithm import Run, attempt, begin, lived, scored
from hiprl.config import Config
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.evaluate import episodes, true_returns
from hiprl.models.reward import EstimatedReward, Gap
from hiprl.models.usual import typical_size
from hiprl.reported import actor_of, confirmed
from hiprl.types import Action, Key, Scalar, State
from hiprl.world.build import world_from
from hiprl.world.jax_world import JaxWorld
from hiprl.world.task import Task


class Known(EstimatedReward):
    """The task's own r in place of a learned one."""

    task: Task

    def __call__(self, s: State, a: Action) -> Scalar:
        return self.task.r(s, a)

    def gap(self, tau: Trajectory, other: Trajectory) -> Gap:
        return Gap(tau.true_return - other.true_return, jnp.zeros(()))

    def returns(self, T: Trajectories) -> Float[Array, " N"]:
        return jnp.where(T.filled, jax.vmap(lambda tau: tau.true_return)(T.rows), -jnp.inf)


@jax.jit
def known(task: Task, T: Trajectories) -> Known:
    """The reward of a task, in the unit of what was seen of it or, where more is known, of what can be."""
    rows, states = T.transitions(), task.anywhere()
    seen = typical_size(jax.vmap(task.r)(rows.s, rows.a), T)
    if states is None:
        return Known(seen, task)
    r = jax.vmap(task.r)(states, jnp.zeros((len(states), task.q)))
    return Known(jnp.maximum(seen, jnp.sqrt(jnp.mean(r**2))), task)


def next_episode(run: Run, world: JaxWorld, config: Config, *, key: Key) -> Run:
    """Algorithm 1's loop without its question."""
    act_key, learn_key = jr.split(jr.fold_in(key, run.k))
    new = attempt(run, world, config, key=act_key)
    calibration = scored(run, new, config).calibration
    after = eqx.tree_at(lambda run: run.k, run, run.k + 1)
    after = lived(after, new, calibration, world, config, key=learn_key)
    return eqx.tree_at(lambda run: run.reward, after, known(world.task, after.T))


def learned(env: str, config: Config, *, seed: int) -> dict[str, Any]:
    """All of a run; gives its outcome as `benchmarks.runner` has it."""
    world = world_from(env)
    assert isinstance(world, JaxWorld), "the reward of a world is known where it is written in JAX"
    began, key = time.perf_counter(), jr.key(seed)
    run = begin(world, config, key=key)
    run = eqx.tree_at(lambda run: run.reward, run, known(world.task, run.T))
    reported: list[float | None] = []
    while int(run.k) < config.comparisons:
        run = next_episode(run, world, config, key=key)
        returns = run.reward.returns(run.T)
        tried = bool(run.archive.filled.any())
        reported.append(float(returns[run.archive.best(returns)]) if tried else None)
        progress(f"{int(run.k)} episodes: executed {float(returns[run.T.last]):.1f}")
    best, _ = confirmed(run, world, config, key=jr.fold_in(key, 1 << 30))
    taus = episodes(world, actor_of(run, best, world, config), 10, key=jr.fold_in(key, (1 << 30) + 1))
    found = true_returns(taus)
    return {
        "return_mean": float(found.mean()),
        "return_std": float(found.std()),
        "reported": reported,
        "executed": [float(x) for x in run.reward.returns(run.T)],
        "wall_seconds": time.perf_counter() - began,
    }
