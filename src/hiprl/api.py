"""hiprl from Python: `learn` a behaviour, `load` one, and `predict` with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.random as jr
import numpy as np
from jaxtyping import ArrayLike

from hiprl.config import Config
from hiprl.errors import InputError
from hiprl.feedback.judges import Judge, judge_from
from hiprl.session import Facts, RunSpec, Watch, actor_of, carry_on, start
from hiprl.store.store import open_store
from hiprl.types import Actor
from hiprl.world.build import world_from
from hiprl.world.task import World


class Learned:
    """A learned behaviour: acts in the units of its environment, and knows how it came about."""

    def __init__(self, actor: Actor, world: World, summary: Facts | None, *, seed: int = 0):
        self.actor = actor
        self.world = world
        self.summary = summary
        """What `hiprl train --json` prints; None for a run that is not finished."""
        self._key = jr.key(seed)
        self._draws = 0

    def predict(
        self, obs: ArrayLike, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """The action for an observation, or one action a row for a batch of them, as Stable-Baselines3 has it.

        Args:
            obs: (p,) or (n, p).
            state: handed back; this policy has no memory.
            episode_start: not used.
            deterministic: the learned behaviour has no noise of its own; False changes nothing but the draws of a
                planner.

        Returns:
            The action in the bounds of the environment, and `state`.
        """
        del episode_start, deterministic
        batch = np.asarray(obs, np.float32)
        if batch.ndim not in (1, 2) or batch.shape[-1] != self.world.p:
            raise InputError(
                f"got an observation of shape {batch.shape}; {self.world.name} has observations of shape "
                f"({self.world.p},), or (n, {self.world.p}) for n of them. Pass what the environment's reset and "
                "step give."
            )
        keys = jr.split(jr.fold_in(self._key, self._draws), max(len(batch), 1) if batch.ndim == 2 else 1)
        self._draws += 1
        if batch.ndim == 1:
            return self.world.scaled(np.asarray(_act(self.actor, batch, keys[0]))), state
        return self.world.scaled(np.asarray(_act_many(self.actor, batch, keys))), state


_act = jax.jit(lambda actor, s, key: actor.act(s, key=key))
_act_many = jax.jit(lambda actor, s, keys: jax.vmap(lambda s, key: actor.act(s, key=key))(s, keys))


def learn(
    env: Any,
    judge: str | Judge = "exact",
    *,
    comparisons: int | None = None,
    seed: int = 0,
    config: Config | None = None,
    horizon: int | None = None,
    terminates: Any = None,
    store: str | Path = "runs/hiprl.db",
    watch: Watch = lambda facts: None,
) -> Learned:
    """Learns a behaviour in `env` from at most `comparisons` answers of `judge`.

    Args:
        env: a Gymnasium id, an environment, a function that makes one, `module:function`, or a World.
        judge: `exact` or `noisy:STD` (by the environment's own reward), or a function of two trajectories that
            says by how much the first is better.
        comparisons: answers asked for; 30 by default.
        seed: decides all draws.
        config: settings; the default ones if None.
        horizon: most steps in an episode, where the environment sets no limit.
        terminates: when an episode ends, if that is known: a function of (s, a, s′) in JAX.
        store: the file, or the database, that keeps the run.
        watch: called with the facts of each episode.

    Raises:
        InputError: something passed in cannot be used.
        JudgeError: the judge gave no answer; resume the run when it can.
        WorldError: the environment broke.
    """
    settings = config or Config()
    if comparisons is not None:
        settings = replace(settings, comparisons=comparisons, warm_up=min(settings.warm_up, comparisons))
    world = world_from(env, horizon=horizon, terminates=terminates)
    answer = judge_from(judge)
    name = judge if isinstance(judge, str) else "custom"
    with open_store(store) as opened:
        run_id = start(opened, world, RunSpec(seed=seed, config=settings, judge=name))
        summary = carry_on(opened, run_id, world, answer, watch=watch)
        return Learned(actor_of(opened, run_id, world), world, summary)


def load(run: str, *, env: Any = None, store: str | Path = "runs/hiprl.db", terminates: Any = None) -> Learned:
    """The behaviour that a run has learned, or the best one so far.

    Args:
        run: the run's id, or the start of it.
        env: its environment; needed where the store does not know how to make it.
        store: where the run is kept.
        terminates: as for `learn`.
    """
    with open_store(store, create=False) as opened:
        row = opened.find_run(run)
        again = env if env is not None else row.spec["env"]
        if again is None:
            raise InputError(
                f"run {row.id} was made from an environment object; to load it, that environment is needed again. "
                "Pass it as env=."
            )
        world = world_from(again, horizon=row.spec["horizon"], terminates=terminates)
        return Learned(actor_of(opened, row.id, world), world, opened.final(row.id))
