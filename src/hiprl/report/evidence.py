"""What a run's answers say: T and P from the store, the reward learned from them again, and how good it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from hiprl.data.preference import WHOLE, Given, Kind, Preferences
from hiprl.data.trajectory import trajectory_from
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.models.estimate import RewardConfig, estimate_reward
from hiprl.models.quality import Held, Shape, cross_validated, shapes
from hiprl.models.reward import JUDGES, AdditiveConfig, AdditiveReward, EstimatedReward
from hiprl.spec import from_plain
from hiprl.store.rows import QuestionRow, RunRow
from hiprl.store.store import Store
from hiprl.world.names import numbered

MOST = 5  # entries of state and action that are named
GOING_ON = "going on"
"""Beside them: what every step is worth, whatever it is like."""


def evidence_of(store: Store, row: RunRow) -> tuple[Trajectories, Preferences]:
    """All trajectories of a run and all its answers; of an answer that was corrected, the newest.

    Raises:
        InputError: nothing was answered yet.
    """
    taus, asked = store.trajectories(row.id), [q for q in store.questions(row.id) if q.answer is not None]
    if not asked:
        raise InputError(
            f"run {row.id} has no answers yet; at least one is needed to learn a reward from. "
            f"Let it go on with `hiprl resume {row.id} --store {store.name}`."
        )
    H = int(row.spec["horizon"])
    p, q = taus[0].states.shape[1], taus[0].actions.shape[1]
    T = Trajectories.empty(len(taus), H=H, p=p, q=q)
    for tau in taus:
        more = {"terminated": tau.terminated, "rewards": tau.rewards, "imagined": tau.imagined}
        T = T.add(trajectory_from(tau.states, tau.actions, H=H, **more))
    return T, given_in(store, row, asked, capacity=len(asked))


def given_in(store: Store, row: RunRow, asked: Sequence[QuestionRow], *, capacity: int) -> Preferences:
    """The newest answers to these questions, in a P of this room."""
    by = {answer.k: answer.judge for answer in store.answers(row.id)}
    judges = {name: i for i, name in enumerate(dict.fromkeys(by.values()))}  # of one moment: more may come
    config = from_plain(row.spec["config"])
    given = [
        Given(
            answer=question.answer,
            clips=[(clip.of, clip.start, WHOLE if clip.length is None else clip.length) for clip in question.clips],
            judge=judges[by[question.k]],
            # an old store does not say: the newest was the one that had been executed for it
            at_hand=question.at_hand or config.number_after(question.k - 1) + 1,
        )
        for question in asked
        if question.answer is not None
    ]
    return Preferences.of(given, capacity, m=max(2, *(len(one.clips) for one in given), config.question.items))


def names_of(row: RunRow, T: Trajectories) -> list[str]:
    """What the entries of (s, a) are called; their numbers, where the run does not say."""
    plain = numbered(T.rows.states.shape[2], T.rows.actions.shape[2])
    named = row.spec.get("names") or plain._asdict()
    names = [*named["state"], *named["action"]]
    often = Counter(names)
    return [name if often[name] == 1 else f"{name} ({i})" for i, name in enumerate(names)]


def as_said(P: Preferences, form: str) -> Preferences:
    """The same answers with less in them: only which clip was better, and of a rating only whether it was good.

    Rankings, which say no more than that of any two clips, stay.
    """
    if form == "all":
        return P
    middle = jnp.clip(P.said.low, -1e9, 1e9) + jnp.clip(P.said.high, -1e9, 1e9)
    above, below = middle > 0, middle < 0
    level = jnp.where(P.said.kind == Kind.NUMBER, Kind.LEVEL, P.said.kind)
    low = jnp.where(above, 0.0, -jnp.inf)
    high = jnp.where(below, 0.0, jnp.inf)
    told = P.said.kind != Kind.RANKING
    said = replace(
        P.said,
        kind=level,
        low=jnp.where(told, low, P.said.low),
        high=jnp.where(told, high, P.said.high),
    )
    return replace(P, said=said)


class Told(NamedTuple):
    """What a run's answers say of the reward."""

    T: Trajectories
    P: Preferences
    reward: AdditiveReward
    shapes: Shape
    names: list[str]
    """Of the entries of (s, a)."""

    @property
    def weights(self) -> dict[str, float]:
        """The entries that r̂ goes by most, with their share in it."""
        return shares(self.reward, self.shapes, self.names)

    @property
    def best(self) -> int:
        """Number of the executed trajectory that r̂ ranks best."""
        return int(np.argmax(np.where(self.T.real, self.reward.returns(self.T), -np.inf)))


def shares(reward: AdditiveReward, shapes: Shape, names: Sequence[str]) -> dict[str, float]:
    """What r̂ goes by most, with its share: entries of (s, a), and that an episode goes on, which is worth its bias."""
    size = dict(zip(map(str, names), np.asarray(shapes.weight).tolist(), strict=True))
    if reward.going_on:
        size[GOING_ON] = abs(reward.going_on)
    total = sum(size.values()) or 1.0
    return {name: size[name] / total for name in sorted(size, key=lambda name: -size[name])[:MOST]}


def told(row: RunRow, T: Trajectories, P: Preferences, config: AdditiveConfig) -> Told:
    """The reward learned from these answers, from nothing, and what it goes by."""
    reward = estimate_reward(P, T, None, config)
    assert isinstance(reward, AdditiveReward)
    return Told(T, P, reward, shapes(reward, T), names_of(row, T))


def quality(T: Trajectories, P: Preferences, config: RewardConfig, *, folds: int = 10) -> dict[str, Any]:
    """How good the learned reward is, by answers that were kept from it: plain numbers, None where not known."""
    held: Held = cross_validated(P, T, config, folds=folds)
    return {
        "answers": int(P.count),
        "held_out_accuracy": held.mean("right"),
        "held_out_log_likelihood": held.mean("log_likelihood"),
        "coverage_90": held.mean("covered"),
        "consistency": consistency(P),
    }


def consistency(P: Preferences) -> float | None:
    """Share of the questions that one judge was asked twice, and answered with the same side; None if none was.

    Of two rankings the share of the pairs in them that are in the same order.
    """
    return _same_side(P, by_one=True)


def agreement(P: Preferences) -> float | None:
    """Share of the questions that two judges were asked, and answered with the same side; None if none was."""
    return _same_side(P, by_one=False)


def _same_side(P: Preferences, *, by_one: bool) -> float | None:
    asked, judge, sides = P.asked(), np.asarray(P.judge), [sides_told(*one) for one in zip(*said_of(P), strict=True)]
    agreed = []
    for i in range(len(asked)):
        for j in range(i):
            both = sides[i].keys() & sides[j].keys()
            if both and asked[i] == asked[j] and (judge[i] == judge[j]) == by_one:
                agreed.append(np.mean([sides[i][pair] == sides[j][pair] for pair in both]))
    return float(np.mean(agreed)) if agreed else None


def said_of(P: Preferences) -> tuple[list[list[tuple[int, int, int]]], list[Kind], list[float]]:
    """The clips of each answer, its kind, and the sign of the difference it tells: NaN where it cannot tell."""
    n = int(P.count)
    low, high = (np.asarray(x)[:n] for x in (P.said.low, P.said.high))
    middle = np.clip(low, -1e9, 1e9) + np.clip(high, -1e9, 1e9)
    sign = np.where(np.isinf(low) & np.isinf(high), np.nan, np.sign(middle))
    return P.shown(), [Kind(kind) for kind in np.asarray(P.said.kind)[:n].tolist()], sign.tolist()


def sides_told(clips: list[tuple[int, int, int]], kind: Kind, sign: float) -> dict[tuple, float]:
    """For each ordered pair of clips whether an answer says that the first is better (1) or worse (-1); of one, too."""
    if kind == Kind.RANKING:
        return {pair[::way]: float(way) for pair in combinations(clips, 2) for way in (1, -1)}
    if np.isnan(sign):
        return {}
    return {tuple(clips): sign, tuple(clips[::-1]): -sign} if len(clips) > 1 else {tuple(clips): sign}


def judges_of(store: Store, row: RunRow) -> list[str]:
    """The names of those whose answers count, by their number in P."""
    by = {answer.k: answer.judge for answer in store.answers(row.id)}
    return list(dict.fromkeys(by.values()))


def opinions(store: Store, row: RunRow, P: Preferences, reward: EstimatedReward) -> dict[str, Any]:
    """Who answered how much and how often each errs, where there are several; and how often they agree.

    Args:
        store: has the run.
        row: of the run.
        P: its answers.
        reward: learned from these.
    """
    names, by = judges_of(store, row), np.asarray(P.judge)[: int(P.count)]
    if len(names) < 2 or not isinstance(reward, AdditiveReward):
        return {"judges": [], "agreement": None}
    mistakes = None if P.only_numbers() else reward.errors.mistakes
    each = [
        {
            "judge": name,
            "answers": int(np.sum(by == i)),
            "mistakes": None if mistakes is None else float(mistakes[min(i, JUDGES - 1)]),
        }
        for i, name in enumerate(names)
    ]
    return {"judges": each, "agreement": agreement(P)}
