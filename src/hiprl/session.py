"""Takes a run from the store, does its episodes, writes them back.

What an episode leaves behind is written in two strokes: the question before the judge is asked, and the facts with a
checkpoint after the models have learned. A run that is killed in between does its unfinished episode again with the
same draws, finds its question in the store, and takes the answer from there if it has come.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from hiprl.algorithm import (
    Attempt,
    Question,
    Run,
    begin,
    episode,
    expected,
    no_trajectories,
    nothing_known,
    number_of,
    practised,
    scored,
)
from hiprl.config import Config
from hiprl.data.answer import Answer
from hiprl.data.film import Film
from hiprl.data.preference import WHOLE, Clip
from hiprl.errors import InputError, JudgeError
from hiprl.evaluate import episodes, true_returns
from hiprl.feedback.judging import Judging, checked
from hiprl.feedback.worth import worth
from hiprl.models.calibration import rollout_errors
from hiprl.models.reward import AdditiveReward
from hiprl.models.reward_network import NetworkConfig
from hiprl.reported import actor_of, best_actor, confirmed
from hiprl.spec import from_plain, to_plain, versions
from hiprl.store.arrays import pack, unpack
from hiprl.store.rows import CUSTOM, PEOPLE, ClipRow, TrajectoryRow
from hiprl.store.store import Store
from hiprl.types import Actor, Key
from hiprl.world.task import World

Facts: TypeAlias = dict[str, Any]
"""What is told of an episode or of a run: plain values, None where a number is not known."""
Watch: TypeAlias = Callable[[Facts], None]
"""Called with the facts of each finished episode."""

HORIZONS = (1, 5, 20, 50)  # of the k-step error of the dynamics model
EVALUATION = 1 << 30  # folded into the run's key for the final evaluation; no run has as many episodes
CONFIRMATION = EVALUATION + 1  # and for the choice of the policy to evaluate


@dataclass(frozen=True, kw_only=True)
class RunSpec:
    """What a run is to be."""

    seed: int
    config: Config
    judge: str
    """Its name, for the record; `custom` for a function."""
    eval_episodes: int = 10
    """Episodes over which the final policy is reported."""
    terminates: str | None = None
    """The rule of termination that was given, as `module:function`; `custom` for a function itself."""
    function: str | None = None
    """The judge's own name, where it is a function."""

    def __post_init__(self) -> None:
        if self.eval_episodes < 1:
            raise InputError(
                f"got {self.eval_episodes} episodes for the final evaluation; at least 1 is needed to report a return. "
                "Say for example `--eval-episodes 10`."
            )
        refuse_seed(self.seed)


def refuse_seed(seed: int) -> None:
    """Sees to it that a seed is one.

    Raises:
        InputError: it is not.
    """
    if not 0 <= seed < 1 << 32:
        raise InputError(
            f"got the seed {seed}; a seed is a whole number from 0 to 4294967295, since draws know 32 bits of it and "
            "no more. Choose one, such as 0."
        )


def start(store: Store, world: World, spec: RunSpec) -> str:
    """Writes a new run into the store, and gives its id. Nothing is executed yet.

    Raises:
        InputError: the reward cannot learn from what the judge is to be asked, or the judge cannot tell.
    """
    asked = spec.config.question
    if spec.judge not in (PEOPLE, CUSTOM):
        refuse_unpriced(world, spec)
    others = asked.clip or asked.levels or asked.items != 2 or asked.pick != "uniform"
    if isinstance(spec.config.reward, NetworkConfig) and others:
        raise InputError(
            f"got the judge {spec.judge} for the paper's reward network, which learns from numbers about whole "
            "trajectories that are picked uniformly. Leave out `--preset paper`, or take `--judge exact` without "
            "`--clip` and `--ask`."
        )
    return store.add_run(
        world.name,
        spec.seed,
        {
            "env": world.spec(),
            "horizon": world.H,
            "names": world.names()._asdict(),
            "judge": spec.judge,
            "function": spec.function,
            "eval_episodes": spec.eval_episodes,
            "terminates": spec.terminates,
            "config": to_plain(spec.config),
        },
        versions(),
    )


def refuse_unpriced(world: World, spec: RunSpec) -> None:
    """Raises InputError if a judge by the environment's reward is to judge what the environment cannot pay for."""
    if spec.config.question.imagined and not world.prices:
        raise InputError(
            f"got a judge by the environment's reward for imagined clips in {world.name}; there is none to go by, as "
            "it pays only for what is executed. Leave imagined clips out, or judge them yourself: with a function of "
            "yours from Python, or by `hiprl teach`."
        )


def spec_of(store: Store, run_id: str) -> RunSpec:
    """What a run in the store was to be."""
    row = store.run(run_id)
    return RunSpec(
        seed=row.seed,
        config=from_plain(row.spec["config"]),
        judge=row.spec["judge"],
        eval_episodes=row.spec["eval_episodes"],
        terminates=row.spec.get("terminates"),
        function=row.spec.get("function"),
    )


def carry_on(store: Store, run_id: str, world: World, judging: Judging, *, watch: Watch = lambda facts: None) -> Facts:
    """Does the episodes that a run still lacks, evaluates it, and gives its summary.

    Raises:
        InputError: the run is finished, another trainer is at it, or the judge cannot tell what it is asked.
        JudgeError: the judge gave no answer; the question stays open.
        WorldError: the environment broke.
        FitDiverged: a model's loss is not finite.
    """
    refuse_finished(store, run_id)
    spec = spec_of(store, run_id)
    if judging.form is not None:
        refuse_unpriced(world, spec)
    with store.lease(run_id) as lease:
        key = jr.key(spec.seed)
        run = latest(store, run_id, world, spec)
        while int(run.k) < spec.config.comparisons:
            run = one_episode(store, run_id, run, world, spec.config, judging, watch, key=key)
            lease.renew()
        return conclude(store, run_id, run, world, spec, key=key)


def refuse_finished(store: Store, run_id: str) -> None:
    """Raises InputError if nothing is left to do."""
    if store.final(run_id) is not None:
        raise InputError(
            f"run {run_id} is finished; only a run that has episodes left can go on. "
            f"Look at it with `hiprl show {run_id} --store {store.name}`, or start a new one with `hiprl train`."
        )


def latest(store: Store, run_id: str, world: World, spec: RunSpec) -> Run:
    """The run as its last finished episode left it; a new one has executed τ_0."""
    saved = store.checkpoint(run_id)
    if saved is not None:
        return unpack(saved[1], shape_of_run(world, spec.config))
    run = begin(world, spec.config, key=jr.key(spec.seed))
    store.add_trajectory(run_id, 0, run.T.get(0), "random", film=in_bytes(world.film))
    return run


def in_bytes(film: Film | None) -> bytes | None:
    """A film as the store keeps it; None where there is none."""
    return None if film is None else film.to_bytes()


def shape_of_run(world: World, config: Config) -> Run:
    """A run with shapes in place of arrays: what a checkpoint is read into."""
    T = no_trajectories(world, config)
    return jax.eval_shape(lambda key: nothing_known(T, config, key=key), jax.eval_shape(jr.key, 0))


def one_episode(
    store: Store, run_id: str, run: Run, world: World, config: Config, judging: Judging, watch: Watch, *, key: Key
) -> Run:
    """Episode k of Algorithm 1, with what it leaves in the store."""
    k = int(run.k) + 1
    times = [time.perf_counter()]

    def ask(question: Question, run: Run, *, key: Key) -> Answer:
        times.append(time.perf_counter())
        answer = asked(store, run_id, k, run, question, judging, key=key)
        times.append(time.perf_counter())
        return answer

    question, answer, after = episode(run, world, config, ask, key=key)
    jax.block_until_ready(after)
    times.append(time.perf_counter())
    after = jax.block_until_ready(practised(after, world, config, key=key))
    times.append(time.perf_counter())
    facts = facts_of(run, question, answer, after, config)
    facts["seconds"] = dict(zip(("propose", "judge", "learn", "practise"), np.diff(times).tolist(), strict=True))
    new = range(int(question.attempt.added(run.T).count), int(after.T.count))
    practice = [(TrajectoryRow.of(after.T.get(number), number=number, kind="policy"), None) for number in new]
    store.finish_episode(run_id, k, facts, pack(after), taus=practice)
    watch(facts)
    return after


def rows_of(new: Attempt, number: int) -> list[TrajectoryRow]:
    """What an episode imagined, if it was to, and what it executed, as the store keeps them, from this number on."""
    kind = "policy" if new.searched else "random"
    taus = [tau for tau in (new.dream, new.tau) if tau is not None]
    return [TrajectoryRow.of(tau, number=i, kind=kind) for i, tau in enumerate(taus, start=number)]


def asked(store: Store, run_id: str, k: int, run: Run, question: Question, judging: Judging, *, key: Key) -> Answer:
    """The answer to episode k's question, which is written down first: from the store if it is there, or the judge.

    Raises:
        JudgeError: the judge gave none, or one that the run's reward cannot learn from. The question stays open.
    """
    T = question.attempt.added(run.T)
    clips = [clip_row(clip) for clip in question.shown]
    store.open_question(run_id, k, rows_of(question.attempt, int(run.T.count)), clips)
    answer = store.answer_of(run_id, k)
    if answer is None:
        try:
            steps = min(int(jnp.max(question.clips.length)), T.rows.actions.shape[1])
            shown = tuple(T.clip(clip) for clip in question.shown)
            answer = checked(judging, shown, T, steps=steps, key=key)
            if answer.form != "number" and store.run(run_id).numbers_only:
                raise JudgeError(
                    f"the judge gave an answer of the form {answer.form!r}; the paper's reward network learns from "
                    "numbers alone. Give one number and resume the run: the question is still open."
                )
        except JudgeError as e:
            raise JudgeError(f"{e} The run is {run_id}.") from e
        store.answer(run_id, k, answer, "rule")
    return answer


def clip_row(clip: Clip) -> ClipRow:
    """A clip as the store keeps it."""
    length = int(clip.length)
    return ClipRow(int(clip.of), int(clip.start), None if length >= WHOLE else length)


def facts_of(run: Run, question: Question, answer: Answer, after: Run, config: Config) -> Facts:
    """What is told of an episode with a question. True returns are for the reader; nothing that learns sees them."""
    g, predicted = number_of(answer), expected(run, question)
    facts = facts_of_attempt(run, question.attempt, after, config) | {
        "comparisons": int(after.k),
        "answer": answer.plain(),
        "g": float(g),
        "foreseen": foreseen(answer, float(predicted.mean)),
        "g_predicted": float(predicted.mean),
        "sigma_g": float(predicted.sigma),
        "alpha": float(after.calibration.alpha) if int(after.calibration.count) else None,
        "worth": worth_of(after, config),
    }
    return finite_or_none(facts)


def facts_of_attempt(run: Run, new: Attempt, after: Run, config: Config) -> Facts:
    """What is told of an episode, whether or not anybody is asked about it."""
    scores = scored(run, new, config)
    returns = after.reward.returns(after.T)
    facts = {
        "k": int(after.k),
        "env_steps": int(jnp.sum(jnp.where(after.T.real, after.T.rows.length, 0))),
        "length": int(new.tau.length),
        "true_return": float(new.tau.true_return),
        "return_by_reward": float(returns[new.added(run.T).last]),
        "searched": new.searched,
    }
    if new.searched:
        errors = rollout_errors(run.dynamics.ensemble, new.tau, HORIZONS)
        best = after.archive.best(returns)
        facts |= {
            "imagined": float(new.report.imagined),
            "imagined_worst": float(new.report.worst),
            "executed": float(scores.executed),
            "overpromised": bool(scores.overpromised),
            "beta": float(jnp.mean(after.calibration.beta)),
            "kappa": float(after.calibration.kappa),
            "deviation": float(scores.errors.deviation),
            "relative_error": float(scores.errors.relative),
            "coverage": float(scores.errors.coverage),
            "rollout_errors": dict(zip(map(str, HORIZONS), map(float, errors), strict=True)),
            "best_trajectory": int(best),
            "best_return": float(after.T.get(best).true_return),
        }
    return facts


def foreseen(answer: Answer, predicted: float) -> float:
    """1 if the side that was said is the predicted one, 0 if not; NaN if none was said, or none predicted."""
    if not answer.side or not math.isfinite(predicted):
        return math.nan
    return float(answer.side == np.sign(predicted))


def worth_of(run: Run, config: Config) -> float:
    """What the next answer is worth, as a share of what was learned; NaN where that is not known."""
    if not isinstance(run.reward, AdditiveReward) or int(run.k) < config.warm_up:
        return math.nan
    return float(worth(run.T, run.reward, config.question, key=jr.key(int(run.k))))


def finite_or_none(x: Any) -> Any:
    """The same with None for each number that is not finite, which JSON has no word for."""
    if isinstance(x, dict):
        return {name: finite_or_none(value) for name, value in x.items()}
    return None if isinstance(x, float) and not math.isfinite(x) else x


def conclude(store: Store, run_id: str, run: Run, world: World, spec: RunSpec, *, key: Key) -> Facts:
    """Evaluates the policy whose executed trajectories the newest r̂ ranks best, and closes the run."""
    began = time.perf_counter()
    best, more_steps = confirmed(run, world, spec.config, key=jr.fold_in(key, CONFIRMATION))
    actor = actor_of(run, best, world, spec.config)
    taus = episodes(world, actor, spec.eval_episodes, key=jr.fold_in(key, EVALUATION))
    returns = true_returns(taus)
    known = bool(jnp.all(jnp.isfinite(returns)))
    facts = store.episodes(run_id)
    summary = {
        "run": run_id,
        "env": world.name,
        "seed": spec.seed,
        "comparisons": int(run.P.count),
        "env_steps": facts[-1][1]["env_steps"] + int(more_steps),
        "return_mean": float(returns.mean()) if known else None,
        "return_std": float(returns.std()) if known else None,
        "eval_episodes": spec.eval_episodes,
        "trajectory": int(best) if bool(run.archive.filled[best]) else None,
        "wall_seconds": sum(sum(episode["seconds"].values()) for _, episode in facts) + time.perf_counter() - began,
        "store": store.name,
    }
    store.finish(run_id, summary, pack(actor))
    return summary


def learned_actor(store: Store, run_id: str, world: World) -> Actor:
    """The policy of a finished run, or the best one so far of a run that is not."""
    spec = spec_of(store, run_id)
    blank = shape_of_run(world, spec.config)
    like = jax.eval_shape(partial(best_actor, world=world, config=spec.config), blank)
    saved = store.policy(run_id)
    if saved is not None:
        return unpack(saved, like)
    checkpoint = store.checkpoint(run_id)
    run = None if checkpoint is None else unpack(checkpoint[1], blank)
    if run is None or not bool(jnp.any(run.archive.filled)):
        raise InputError(
            f"run {run_id} has not searched for a policy yet, as it does once it has seen the first episodes. "
            f"Let it go on with `hiprl resume {run_id} --store {store.name}`."
        )
    return best_actor(run, world, spec.config)
