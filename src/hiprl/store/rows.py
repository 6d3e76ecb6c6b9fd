"""What the store gives back: one frozen class a kind of row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np

from hiprl.data.answer import Answer
from hiprl.store.arrays import array_from_bytes, array_to_bytes

Kind: TypeAlias = Literal["random", "policy"]
"""How a trajectory came about: by random actions, or by the policy of its episode."""
PEOPLE = "people"
"""In place of a judge's name in the row of a run that people teach."""
CUSTOM = "custom"
"""There for a judge, or a rule of termination, that is a function, which a row cannot hold."""


@runtime_checkable
class Executed(Protocol):
    """What a trajectory has: `hiprl.data`'s, known by its shape as JAX takes a second to import, or a row."""

    @property
    def states(self) -> Any: ...
    @property
    def actions(self) -> Any: ...
    @property
    def rewards(self) -> Any: ...
    @property
    def length(self) -> Any: ...
    @property
    def terminated(self) -> Any: ...
    @property
    def imagined(self) -> Any: ...


@dataclass(frozen=True, kw_only=True)
class RunRow:
    """A run as it was begun: enough to do it again."""

    id: str
    created_at: datetime
    env: str
    seed: int
    spec: dict[str, Any]
    """Whatever else was chosen: preset, config, judge, horizon."""
    versions: dict[str, str]
    """Of hiprl, Python and the libraries that draws depend on."""

    @property
    def numbers_only(self) -> bool:
        """Whether its reward can learn from nothing but numbers."""
        return numbers_only(self.spec)


def numbers_only(spec: Mapping[str, Any]) -> bool:
    """Whether the reward of a run that is to be so can learn from nothing but numbers, as the paper's network."""
    return spec.get("config", {}).get("reward", {}).get("part") == "NetworkConfig"


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryRow:
    """A trajectory τ, without padding, in NumPy arrays."""

    number: int
    """Its index in T."""
    kind: Kind
    states: np.ndarray
    """(length + 1, p)"""
    actions: np.ndarray
    """(length, q), each entry in [-1, 1]."""
    rewards: np.ndarray
    """(length,): what the environment paid, NaN where nothing. For scripted judges and reports only."""
    length: int
    terminated: bool
    imagined: bool = False
    """Nobody executed it: it is what the policy does in the model."""

    @classmethod
    def of(cls, tau: Executed, *, number: int, kind: Kind) -> TrajectoryRow:
        """A trajectory as a row; its padding is dropped."""
        n = int(tau.length)
        return cls(
            number=number,
            kind=kind,
            states=np.asarray(tau.states)[: n + 1],
            actions=np.asarray(tau.actions)[:n],
            rewards=np.asarray(tau.rewards)[:n],
            length=n,
            terminated=bool(tau.terminated),
            imagined=bool(tau.imagined),
        )

    @classmethod
    def read(cls, row: Any) -> TrajectoryRow:
        """The trajectory in a row of the table."""
        return cls(
            number=row.number,
            kind=row.kind,
            states=array_from_bytes(row.states),
            actions=array_from_bytes(row.actions),
            rewards=array_from_bytes(row.rewards),
            length=row.length,
            terminated=row.terminated,
            imagined=row.imagined,
        )

    def values(self) -> dict[str, Any]:
        """Column to value."""
        return {
            "number": self.number,
            "kind": self.kind,
            "states": array_to_bytes(self.states),
            "actions": array_to_bytes(self.actions),
            "rewards": array_to_bytes(self.rewards),
            "length": self.length,
            "terminated": self.terminated,
            "imagined": self.imagined,
        }

    def differs_from(self, other: TrajectoryRow) -> str | None:
        """The first place where the two are not the same bit for bit, in words; None if there is none."""
        for name in ("states", "actions", "rewards"):
            mine, others = getattr(self, name), getattr(other, name)
            if mine.dtype != others.dtype or mine.shape[1:] != others.shape[1:]:
                kinds = f"{mine.dtype}{list(mine.shape)} and {others.dtype}{list(others.shape)}"
                return f"its {name} are {kinds}"
            for t, (one, another) in enumerate(zip(mine, others, strict=False)):
                if one.tobytes() != another.tobytes():
                    return f"its {name} differ from step {t} on"
        for name in ("length", "terminated", "kind", "imagined"):
            mine, others = getattr(self, name), getattr(other, name)
            if mine != others:
                return f"its {name} is {mine} and {others}"
        return None


@dataclass(frozen=True)
class ClipRow:
    """Some steps of a trajectory of the run; all of them, if nothing else is said."""

    of: int
    """Number of the trajectory."""
    start: int = 0
    """Its first step."""
    length: int | None = None
    """At most so many steps; None goes on to the end."""

    def __str__(self) -> str:
        if self.length is None:
            return f"{self.of}[{self.start}:]" if self.start else f"{self.of}"
        return f"{self.of}[{self.start}:{self.start + self.length}]"

    def plain(self) -> tuple[int, int, int | None]:
        """As JSON keeps it, also where the numbers are NumPy's or JAX's."""
        return int(self.of), int(self.start), None if self.length is None else int(self.length)


@dataclass(frozen=True, kw_only=True)
class QuestionRow:
    """Which of some clips is better, or how good is one? Asked in episode k."""

    id: int
    run_id: str
    k: int
    first: int
    """Number of the first clip's trajectory."""
    second: int
    """Of the second clip's; of the first's, if there is but one."""
    clips: tuple[ClipRow, ...]
    """One to eight."""
    created_at: datetime
    answer: Answer | None
    """The newest one. None while it is open."""
    at_hand: int | None = None
    """How many trajectories there were when it was asked; None where an old store does not say."""

    @classmethod
    def read(cls, row: Any) -> QuestionRow:
        """The question in a row of the table, with what was said (None: nothing yet)."""
        return cls(
            id=row.id,
            run_id=row.run_id,
            k=row.k,
            first=row.first,
            second=row.second,
            clips=tuple(ClipRow(*clip) for clip in row.clips),
            created_at=row.created_at,
            answer=None if row.said is None else Answer.read(row.said),
            at_hand=row.at_hand,
        )

    @property
    def g(self) -> float | None:
        """The newest answer if it is a number; > 0 means that the first clip is better."""
        return number_of(self.answer)


@dataclass(frozen=True, kw_only=True)
class AnswerRow:
    """What a judge said; a later one for the same k corrects it."""

    k: int
    answer: Answer
    judge: str
    swapped: bool
    """The judge was shown the second one first (the answer still speaks of the question's own order)."""
    created_at: datetime

    @property
    def g(self) -> float | None:
        """By how much the question's first clip is better than its second, if a number was said."""
        return number_of(self.answer)


def number_of(answer: Answer | None) -> float | None:
    """The number that was said; None where nothing, or something else, was."""
    if answer is None or answer.form != "number" or not isinstance(answer.value, int | float):
        return None
    return float(answer.value) + 0.0  # turns -0.0, whose sign SQLite loses, into 0.0 everywhere
