"""Learns from people, whose answers come through the store, whenever they like.

Three things go on at the same time. One practises: it searches, executes and learns the world, and never waits for an
answer. One sees to it that questions are open that nobody looks at yet, so that nobody who answers waits for a search
or a fit. One takes new answers in and learns the reward again. They meet in `Known`; trainer and page meet in the store
only.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float

from hiprl.algorithm import BEGINNING, Run, attempt, lived, scored
from hiprl.config import Config
from hiprl.data.preference import Clip, Preferences
from hiprl.data.trajectory_set import Trajectories
from hiprl.feedback.questions import pick_clips
from hiprl.models.estimate import estimate_reward
from hiprl.models.quality import shapes
from hiprl.models.reward import AdditiveReward, EstimatedReward
from hiprl.report.evidence import given_in, names_of, opinions, shares
from hiprl.session import (
    Facts,
    Watch,
    clip_row,
    conclude,
    facts_of_attempt,
    finite_or_none,
    foreseen,
    in_bytes,
    latest,
    refuse_finished,
    rows_of,
    spec_of,
    worth_of,
)
from hiprl.store.arrays import pack
from hiprl.store.rows import ClipRow, QuestionRow, RunRow
from hiprl.store.store import Store
from hiprl.types import Key
from hiprl.world.task import World

OPEN = 2  # questions that nobody looks at yet, besides those that somebody does
SEEN = 3  # episodes that there are before the first question
KEPT = 0.5  # share of the questions, the last ones, that is kept until there is something new to ask about
REHEARSALS = 3  # episodes of practice that are something new
FIRST = 4  # answers before the first search: by fewer, anything could be wanted
AGAIN = 6  # one question in so many is one that was answered, for another judge: do they agree?
TRIES = 10  # to find a question that was not asked before: some are about two trajectories alone
PRACTICE = 4  # episodes without news (an answer, or a better policy by r̂) after which practising waits for an answer
LITTLE = 0.01  # of what was gained so far: less is no news
LOOK = 0.2  # seconds between two looks for answers
ASKING = BEGINNING - 1  # folded into the run's key for questions; no run has as many episodes


class Known:
    """What is known at this moment. Each thread changes its own parts."""

    def __init__(self, run: Run):
        self._run = run
        self._lock = threading.Lock()
        self.answers = int(run.P.count)
        self.heard = 0
        """How often r̂ was learned anew: by a corrected answer, too."""

    @property
    def run(self) -> Run:
        """All of it."""
        return self._run

    def with_answers(self, run: Run) -> Run:
        """The same with the answers and r̂ that there are by now."""
        newest = self._run  # looked at once: both must be of the same moment
        return eqx.tree_at(lambda run: (run.P, run.reward), run, (newest.P, newest.reward))

    def lived(self, run: Run) -> None:
        """Takes over all but the answers and r̂, which may be newer here."""
        with self._lock:
            self._run = self.with_answers(run)

    def told(self, P: Preferences, reward: EstimatedReward) -> None:
        """Takes over the answers and r̂."""
        with self._lock:
            self._run = eqx.tree_at(lambda run: (run.P, run.reward), self._run, (P, reward))
            self.answers = int(P.count)
            self.heard += 1


class Asking:
    """Keeps questions open until as many were asked as the run is to have, and takes answers in."""

    def __init__(self, store: Store, row: RunRow, config: Config, known: Known, *, key: Key):
        self.store, self.row, self.config, self.known, self.key = store, row, config, known, key
        self.foresight: list[float] = []
        """Of the answers since the last episode: 1 where r̂ had foreseen the side, 0 where not."""
        self.weights: dict[str, float] = {}
        self.verdicts: Facts = {"agrees": [], "disagrees": [], "heard": 0}
        """Questions that r̂ answers as the judge did, those that it would answer otherwise, and how many answers there
        were, corrected ones too, when this was found: it tells nothing of later ones."""
        self.opinions: dict[str, Any] = {}
        """Who answered, and how often each errs, where there are several."""
        self.trainer_waits = False
        """Whether nothing is tried before the next answer: then no question is kept for later."""
        self.exhausted = False
        """Whether all pairs that there are were asked and answered: something has to be tried before the next one."""
        self.stop = threading.Event()
        self.failed: BaseException | None = None
        self._seen: dict[int, Any] | None = None
        """The answers that r̂ knows; None before the first look, whose answers it may know already."""
        turns = {"asking": self.ask, "listening": self.listen}
        self._threads = [threading.Thread(target=self._go_on, args=(turns[name],), name=name) for name in turns]

    def __enter__(self) -> Asking:
        for thread in self._threads:
            thread.daemon = True  # a trainer that is killed does not wait for it
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        for thread in self._threads:
            thread.join()

    def _go_on(self, turn: Callable[[], None]) -> None:
        try:
            turn()
            while not self.stop.wait(LOOK):
                turn()
        except BaseException as error:  # told by the thread that practises, which everybody listens to
            self.failed = error

    def listen(self) -> None:
        """Takes in what was answered since the last time."""
        given = self.store.answers(self.row.id)
        answered = {row.k: row.answer for row in given}  # the newest of each
        if answered and answered != self._seen:
            asked = self.store.questions(self.row.id)
            questions = [replace(question, answer=answered.get(question.k)) for question in asked]
            before = self._seen if self._seen is not None else answered if self.known.answers else {}
            self._take_in(questions, new=[k for k, said in answered.items() if before.get(k) != said], heard=len(given))
        self._seen = answered

    def ask(self) -> None:
        """Asks until enough is open, with what is known by now: a newer r̂ is not waited for."""
        if self.store.enough(self.row.id):
            return
        questions = self.store.questions(self.row.id)
        asked, before = len(questions), {frozenset(question.clips) for question in questions}
        while asked < self.most() and self.store.unseen(self.row.id) < OPEN and not self.stop.is_set():
            new = self._ask_again(asked + 1, questions) or self._ask(asked + 1, before)
            if new is None:
                self.exhausted = asked == self.store.asked(self.row.id)[1]
                break
            asked += 1
            before.add(new)

    def behind(self) -> bool:
        """Whether r̂ has not heard all answers yet."""
        return self.store.asked(self.row.id)[1] > len(self._seen or {})

    def most(self) -> int:
        """How many questions may be asked by now: the last are about what it tried because of the first."""
        K, tried = self.config.comparisons, int(np.sum(self.known.run.archive.filled))
        return K if tried >= REHEARSALS or self.trainer_waits else min(K, max(FIRST, K - int(KEPT * K)))

    def _take_in(self, questions: list[QuestionRow], *, new: list[int], heard: int) -> None:
        run = self.known.run
        if int(run.P.count):
            sides = sides_of(run, questions)
            self.foresight += [right for k in new if np.isfinite(right := sides[k])]
        P = given_in(self.store, self.row, questions, capacity=self.config.comparisons)
        reward = estimate_reward(P, run.T, run.reward, self.config.reward)
        self.known.told(P, reward)
        after = self.known.run
        sides = sides_of(after, questions)
        agrees, disagrees = ([k for k, side in sides.items() if side == right] for right in (1, 0))
        self.verdicts = {"agrees": agrees, "disagrees": disagrees, "heard": heard}
        if isinstance(reward, AdditiveReward):
            self.weights = shares(reward, shapes(reward, after.T), names_of(self.row, after.T))
            self.opinions = opinions(self.store, self.row, P, reward)

    def _ask_again(self, k: int, questions: list[QuestionRow]) -> frozenset[ClipRow] | None:
        """Asks the newest question that was answered, and asked once only; None if it is not time for that."""
        if k % AGAIN or len(self.opinions.get("judges", [])) < 2:
            return None
        times = Counter(frozenset(question.clips) for question in questions)
        for question in reversed(questions):
            if question.answer is not None and times[frozenset(question.clips)] == 1:
                self.store.ask(self.row.id, k, question.clips)
                return frozenset(question.clips)
        return None

    def _ask(self, k: int, before: set[frozenset[ClipRow]]) -> frozenset[ClipRow] | None:
        """Asks something new; None if there is nothing before the next episode."""
        run = self.known.run
        shown = stacked(before, room=self.config.comparisons, items=self.config.question.items)
        for try_key in jr.split(jr.fold_in(self.key, k), TRIES):
            clips = pick_clips(run.T, run.reward, self.config.question, before=shown, key=try_key)
            each = zip(clips.of, clips.start, clips.length, strict=True)
            rows = [clip_row(Clip(*one)) for one in each]
            if frozenset(rows) not in before:
                self.store.ask(self.row.id, k, rows)
                return frozenset(rows)
        return None


def stacked(asked: set[frozenset[ClipRow]], *, room: int, items: int) -> Clip:
    """What was asked, a row a question, with rows of nothing at the end: one shape, one compilation."""
    rows = [[(clip.of, clip.start, 0) for clip in clips] for clips in asked if len(clips) == items]
    plain = np.array([*rows, *[[(-1, 0, 0)] * items] * (room - len(rows))], np.int32)
    return Clip(*(jnp.asarray(x) for x in np.moveaxis(plain, 2, 0)))


def sides_of(run: Run, questions: list[QuestionRow]) -> dict[int, float]:
    """For each answered question, 1 where r̂ is of the judge's opinion, 0 where not, NaN where there is none."""
    answered = [question for question in questions if question.answer is not None]
    filled = answered + answered[:1] * (run.P.capacity - len(answered))  # one shape, one compilation
    if not answered:
        return {}
    first, last = (jax.tree.map(lambda *x: jnp.stack(x), *(clip_of(one, i) for one in filled)) for i in (0, -1))
    predicted = np.asarray(gaps(run.T, run.reward, first, last))
    return {one.k: foreseen(one.answer, float(g)) for one, g in zip(answered, predicted, strict=False) if one.answer}


@jax.jit
def gaps(T: Trajectories, reward: EstimatedReward, first: Clip, last: Clip) -> Float[Array, " n"]:
    """By how much each of the first clips is better by r̂ than the last one beside it."""
    return jax.lax.map(lambda pair: reward.gap(T.clip(pair[0]), T.clip(pair[1])).mean, (first, last))


def clip_of(question: QuestionRow, i: int) -> Clip:
    """One of the clips that a question shows."""
    of, start, length = question.clips[i].plain()
    return Clip.whole(of) if length is None else Clip.at(of, start, length)


def taught(
    store: Store,
    run_id: str,
    world: World,
    *,
    watch: Watch = lambda facts: None,
    wait: Callable[[str], None] = lambda what: None,
) -> Facts:
    """Learns from the answers that come, until the run has as many as it is to have, or a judge says enough.

    Gives its summary.

    Args:
        store: where questions are asked and answers come.
        run_id: of the run.
        world: where it acts.
        watch: called with the facts of each episode.
        wait: called with words for what it waits for, when that changes.

    Raises:
        InputError: the run is finished, or another trainer is at it.
        WorldError: the environment broke.
        FitDiverged: a model's loss is not finite.
    """
    refuse_finished(store, run_id)
    row, spec = store.run(run_id), spec_of(store, run_id)
    config, key = spec.config, jr.key(spec.seed)
    with store.lease(run_id) as lease:
        scene = world.start_filming()
        store.set_scene(run_id, scene or states_only(world))
        known = Known(latest(store, run_id, world, spec))
        while episodes_of(known.run) < min(SEEN, config.warm_up):
            practised(store, run_id, known, world, config, None, watch, key=key)
        with Asking(store, row, config, known, key=jr.fold_in(key, ASKING)) as asking:
            idle, heard, waits = 0, 0, ""
            while True:
                if asking.failed is not None:
                    raise asking.failed
                idle, heard, answers = 0 if known.heard != heard else idle, known.heard, known.answers
                to_come = 0 if store.enough(run_id) else max(0, config.comparisons - answers)
                lived_so_far, most = episodes_of(known.run), config.executed_after(config.comparisons)
                room = lived_so_far < max(config.warm_up, most - to_come)  # an episode an answer
                resting = idle >= PRACTICE or not room
                if not to_come and resting and not asking.behind():
                    break
                warm = lived_so_far >= config.warm_up
                few = warm and to_come > 0 and answers < FIRST and not asking.exhausted
                pauses = few or (resting and not (room and asking.exhausted))
                asking.trainer_waits = pauses and not few
                before, waits = waits, "" if not pauses else "the first answers" if few else "an answer"
                if waits != before:
                    wait(waits)
                if pauses:
                    time.sleep(LOOK)
                    continue
                practised(store, run_id, known, world, config, asking, watch, key=key)
                asking.exhausted = False
                idle = 0 if not warm or news(known.run) else idle + 1
                lease.renew()
        return conclude(store, run_id, known.run, world, spec, key=key)


def practised(
    store: Store,
    run_id: str,
    known: Known,
    world: World,
    config: Config,
    asking: Asking | None,
    watch: Watch,
    *,
    key: Key,
) -> None:
    """One more episode, with what it leaves in the store."""
    run = known.run
    act_key, learn_key = jr.split(jr.fold_in(key, run.k))
    times = [time.perf_counter()]
    new = attempt(run, world, config, key=act_key)
    times.append(time.perf_counter())
    calibration = scored(run, new, config).calibration
    after = lived(eqx.tree_at(lambda run: run.k, run, run.k + 1), new, calibration, world, config, key=learn_key)
    after = known.with_answers(jax.block_until_ready(after))
    times.append(time.perf_counter())
    facts = facts_of_attempt(run, new, after, config)
    facts |= {"comparisons": int(after.P.count), "worth": worth_of(after, config)}
    facts["seconds"] = dict(zip(("propose", "learn"), np.diff(times).tolist(), strict=True)) | {"judge": 0.0}
    if asking is not None:
        told, asking.foresight = asking.foresight, []
        facts |= {"foreseen": float(np.mean(told)) if told else None, "told": len(told)}
        facts |= {"weights": asking.weights, **asking.verdicts, **asking.opinions}
    facts = finite_or_none(facts)
    taus = [
        (row, in_bytes(world.film_of(row.states) if row.imagined else world.film))
        for row in rows_of(new, int(run.T.count))
    ]
    store.finish_episode(run_id, facts["k"], facts, pack(after), taus=taus)
    known.lived(after)  # now it may be asked about
    watch(facts)


def episodes_of(run: Run) -> int:
    """How many episodes there were."""
    return int(jnp.sum(run.T.real))


def news(run: Run) -> bool:
    """Whether the newest policy is better than all before it."""
    real = np.asarray(run.T.real)
    return improved(np.asarray(run.reward.returns(run.T))[real], np.asarray(run.archive.filled)[real])


def improved(returns: np.ndarray, tried: np.ndarray) -> bool:
    """Whether the last of these returns by r̂ exceeds those of all policies before by more than next to nothing."""
    *earlier, newest = returns
    before = np.array(earlier)[tried[: len(earlier)]]
    return not len(before) or bool(newest - before.max() > LITTLE * (before.max() - np.mean(earlier)))


def states_only(world: World) -> dict[str, Any]:
    """The scene of a world of which there is nothing to be seen but its states."""
    return {"kind": "states", "dt": 0.05, "names": list(world.names().state)}
