"""hiprl from Python: `learn` a behaviour, `load` one, and `predict` with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.random as jr
import numpy as np
from jaxtyping import ArrayLike

from hiprl.config import Config, asking
from hiprl.errors import InputError
from hiprl.feedback.judges import judge_from
from hiprl.feedback.judging import Judge, Judging
from hiprl.feedback.questions import Pick
from hiprl.session import Facts, RunSpec, Watch, carry_on, learned_actor, refuse_finished, start
from hiprl.store.rows import CUSTOM, PEOPLE, RunRow
from hiprl.store.store import Store, open_store
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
            deterministic: not used: the learned behaviour has no noise of its own, and a planner draws in any case.

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
        key = jr.fold_in(self._key, self._draws)
        self._draws += 1
        if batch.ndim == 1:
            return self.world.scaled(np.asarray(_act(self.actor, batch, key))), state
        return self.world.scaled(np.asarray(_act_many(self.actor, batch, jr.split(key, len(batch))))), state


_act = jax.jit(lambda actor, s, key: actor.act(s, key=key))
_act_many = jax.jit(lambda actor, s, keys: jax.vmap(lambda s, key: actor.act(s, key=key))(s, keys))


def learn(
    env: Any,
    judge: str | Judge = "exact",
    *,
    comparisons: int | None = None,
    seed: int = 0,
    config: Config | None = None,
    clip: int | None = None,
    ask: Pick | None = None,
    practice: int | None = None,
    imagined: bool = False,
    horizon: int | None = None,
    terminates: Any = None,
    store: str | Path = "runs/hiprl.db",
    watch: Watch = lambda facts: None,
) -> Learned:
    """Learns a behaviour in `env` from at most `comparisons` answers of `judge`.

    Args:
        env: a Gymnasium id, an environment, a function that makes one, `module:function`, or a World.
        judge: by the environment's own reward, `exact`, `noisy:STD`, `choice`, `graded`, `slider`, `ranking` or
            `rating`; or a function of two trajectories that says by how much the first is better, as a number or as an
            `Answer`.
        comparisons: answers asked for; 30 by default.
        seed: decides all draws.
        config: settings; the default ones if None.
        clip: steps of the clips that are compared, 0 for whole trajectories; what suits the judge if None.
        ask: `uniform` or `information`, how the clips are picked; what suits the judge if None.
        practice: episodes after each answer that nobody is asked about; what suits the judge if None, but no fewer
            than `config` has.
        imagined: ask about what a new policy does in the model as well; such a clip has `imagined` set.
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
    judging = judge_from(judge)
    settings = asking(settings, judging, clip=clip, pick=ask, practice=practice, imagined=imagined)
    rule = None if terminates is None else named(terminates)
    spec = RunSpec(seed=seed, config=settings, judge=named(judge), terminates=rule, function=function_of(judge))
    with new_store(store) as opened:
        return gone_on(opened, start(opened, world, spec), world, judging, watch)


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
        world = world_of(row, env=env, terminates=terminates)
        return Learned(learned_actor(opened, row.id, world), world, opened.final(row.id))


def resume(
    run: str,
    judge: str | Judge | None = None,
    *,
    env: Any = None,
    terminates: Any = None,
    store: str | Path = "runs/hiprl.db",
    watch: Watch = lambda facts: None,
) -> Learned:
    """Goes on with a run that was stopped, with the draws that it would have had.

    Args:
        run: the run's id, or the start of it.
        judge: as for `learn`; needed where the run's own was a function, and that one by default otherwise.
        env: its environment; needed where the store does not know how to make it.
        terminates: its rule of termination; needed where that was a function.
        store: where the run is kept.
        watch: called with the facts of each episode that is still to come.

    Raises:
        InputError: there is no such run, it is finished or being trained, or it needs what was not passed in.
        JudgeError: the judge gave no answer; resume the run when it can.
        WorldError: the environment broke.
    """
    with open_store(store, create=False) as opened:
        row = opened.find_run(run)
        refuse_finished(opened, row.id)
        judging = judge_of(row, judge)
        world = world_of(row, env=env, terminates=terminates)
        return gone_on(opened, row.id, world, judging, watch)


def gone_on(store: Store, run_id: str, world: World, judging: Judging, watch: Watch) -> Learned:
    """What a run has learned once it is at its end; what stops it before is told how to go on."""
    try:
        summary = carry_on(store, run_id, world, judging, watch=watch)
    except InputError:  # it was not begun
        raise
    except BaseException as stopped:  # Ctrl-C as well
        stopped.add_note(f"What is finished is stored, as run {run_id} in {store.name}. Go on with hiprl.resume.")
        raise
    return Learned(learned_actor(store, run_id, world), world, summary)


def new_store(where: str | Path) -> Store:
    """The store at a path or an address, its folder made if there is none.

    Raises:
        InputError: the folder cannot be made.
    """
    if isinstance(where, Path) or "://" not in where:
        folder = Path(where).expanduser().parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"cannot make the folder {folder} for the store ({error.strerror or error}); one that can be written "
                "is needed. Name a file in a folder of your own."
            ) from error
    return open_store(where)


def named(given: object) -> str:
    """What a run's row says of a judge or a rule: its name, or `custom` for a function."""
    return given if isinstance(given, str) else CUSTOM


def function_of(judge: object) -> str | None:
    """What a function that judges is called, if anything; None for a judge with a name."""
    if isinstance(judge, str):
        return None
    name = getattr(judge, "__qualname__", type(judge).__qualname__)
    return f"{getattr(judge, '__module__', None) or type(judge).__module__}.{name}"


def judge_of(row: RunRow, judge: str | Judge | None = None) -> Judging:
    """The judge of a run that goes on: the one that is passed in, or its own if that has a name."""
    if judge is None and row.spec["judge"] == CUSTOM:
        raise InputError(
            f"run {row.id} was begun with a function as its judge; to go on, it needs that function again. "
            f"Pass it from Python: hiprl.resume({row.id!r}, judge)."
        )
    if row.spec["judge"] == PEOPLE:
        raise InputError(
            f"run {row.id} is taught by people; to go on, it needs its page and their answers. "
            f"Type `hiprl resume {row.id}`, or begin a run with a judge of yours: hiprl.learn(env, judge)."
        )
    return judge_from(row.spec["judge"] if judge is None else judge)


def world_of(row: RunRow, *, env: Any = None, terminates: Any = None) -> World:
    """The world of a run in the store, made again from its row and what a row cannot hold."""
    again = row.spec["env"] if env is None else env
    if again is None:
        raise InputError(
            f"run {row.id} was made from an environment object; to use the run, that environment is needed again. "
            f"Pass it from Python, as env=: hiprl.resume({row.id!r}, env=env) or hiprl.load({row.id!r}, env=env)."
        )
    rule = row.spec.get("terminates") if terminates is None else terminates
    if rule == CUSTOM:
        raise InputError(
            f"run {row.id} was begun with a function as its rule of termination; that function is needed again. "
            "Pass it from Python as terminates=, or name it as --terminates module:function."
        )
    return world_from(again, horizon=row.spec["horizon"], terminates=rule)
