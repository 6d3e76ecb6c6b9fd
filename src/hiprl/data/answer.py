"""What a judge says about clips: plain values, as they are stored, exported and shown."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from hiprl.errors import InputError

Form: TypeAlias = Literal["number", "choice", "level", "slider", "equal", "unsure", "ranking", "rating"]
FORMS: tuple[Form, ...] = get_args(Form)
EQUAL = 0.25
"""Half the width of "equal", where a whole scale is 1: as wide as the middle one of five levels."""
MOST_LEVELS = 1001
"""More than anybody tells apart; for more there is the slider."""
LARGEST = 1e15
"""Of a number that is taken in, either way: its square must be one too, in single precision."""
SLIDER = 0.1
"""Half the width of a slider's answer: nobody sets it more exactly than to a tenth of either side."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One answer. Positive values say that the first of two clips is better.

    Numbers of NumPy and JAX become those of Python, and lists tuples.

    Raises:
        InputError: value and levels are not what the form needs.
    """

    form: str
    """`number`: by how much the first is better, in the judge's own unit. `choice`: 1 the first, -1 the second.
    `level`: one of `levels` from worst to best, 0 in their middle. `slider`: from -1 to 1. `equal`, `unsure`: no value.
    `ranking`: the numbers of the clips, best first. `rating`: one of `levels`, for a single clip."""
    value: Any = None
    levels: Any = None
    """How many there are, for `level` and `rating`."""

    def __post_init__(self) -> None:
        for name in ("value", "levels"):
            object.__setattr__(self, name, _plain(getattr(self, name)))
        if not self.sensible():
            raise InputError(
                f"got the answer {self.value!r} of the form {self.form!r}"
                + (f" with {self.levels} levels" if self.levels is not None else "")
                + f"; {_NEEDED.get(self.form, 'the forms are ' + ', '.join(FORMS))}. Answer again."
            )

    def sensible(self) -> bool:
        """Whether value and levels are what the form needs."""
        x, levels = self.value, self.levels
        if self.form in ("level", "rating"):
            half = (levels - 1) / 2 if type(levels) is int and 2 <= levels <= MOST_LEVELS else -1
            return _is_number(x) and -half <= x <= half and (x - half) % 1 == 0
        if levels is not None:
            return False
        match self.form:
            case "number":
                return _is_number(x)
            case "choice":
                return _is_number(x) and x in (-1, 1)
            case "slider":
                return _is_number(x) and -1 <= x <= 1
            case "equal" | "unsure":
                return x is None
            case "ranking":
                whole = isinstance(x, tuple) and all(type(i) is int for i in x)
                return whole and len(x) >= 2 and sorted(x) == list(range(len(x)))
        return False

    @property
    def items(self) -> int:
        """How many clips it is about."""
        return len(self.value) if isinstance(self.value, tuple) else 1 if self.form == "rating" else 2

    @property
    def side(self) -> int:
        """1 if it says that the first of two clips is better, -1 the second; 0 if it says neither."""
        if self.form in ("number", "choice", "level", "slider"):
            return (self.value > 0) - (self.value < 0)
        return 0

    def bounds(self) -> tuple[float, float]:
        """Between what the perceived difference lies, where a whole scale is 1. A number is its own bounds."""
        x = float(self.value) if _is_number(self.value) else 0.0
        match self.form:
            case "number":
                return x, x
            case "choice":
                return (0.0, math.inf) if x > 0 else (-math.inf, 0.0)
            case "slider":
                low = -math.inf if x <= SLIDER - 1 else x - SLIDER
                return low, math.inf if x >= 1 - SLIDER else x + SLIDER
            case "equal":
                return -EQUAL, EQUAL
            case "level" | "rating":
                half, step = (self.levels - 1) / 2, 2 / (self.levels - 1)
                low = -math.inf if x <= -half else (x - 0.5) * step
                return low, math.inf if x >= half else (x + 0.5) * step
        return -math.inf, math.inf

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it."""
        value = list(self.value) if isinstance(self.value, tuple) else self.value
        return {"form": self.form, "value": value} | ({"levels": self.levels} if self.levels is not None else {})

    @classmethod
    def read(cls, plain: Mapping[str, Any]) -> Answer:
        """What `plain` gave.

        Raises:
            InputError: it is no answer.
        """
        strange = sorted(set(plain) - {"form", "value", "levels"})
        if strange or not isinstance(plain.get("form"), str):
            raise InputError(
                f"got an answer with the entries {', '.join(map(repr, plain)) or 'none'}; it needs form, and value and "
                "levels as the form says. Look at what `hiprl export` writes."
            )
        return cls(form=plain["form"], value=plain.get("value"), levels=plain.get("levels"))

    @classmethod
    def taken(cls, plain: Mapping[str, Any]) -> Answer:
        """`read` of what somebody sent: something that can be learned from.

        Raises:
            InputError: it is no answer, or a number too large.
        """
        answer = cls.read(plain)
        if answer.form == "number" and abs(answer.value) > LARGEST:
            raise InputError(
                f"got the number {answer.value:g}; one from -{LARGEST:g} to {LARGEST:g} is needed. "
                "Give all numbers of this judge in a larger unit."
            )
        return answer


_NEEDED = {
    "number": "a finite number is needed",
    "choice": "1 for the first clip or -1 for the second is needed",
    "slider": "a number from -1 to 1 is needed",
    "level": "a level from -(levels - 1)/2 to (levels - 1)/2 in steps of 1 is needed, of 2 to 1001 levels",
    "rating": "a level from -(levels - 1)/2 to (levels - 1)/2 in steps of 1 is needed, of 2 to 1001 levels",
    "equal": "`equal` has no value",
    "unsure": "`unsure` has no value",
    "ranking": "the numbers of all clips from 0 are needed, best first",
}


def _plain(x: Any) -> Any:
    """Numbers of NumPy and JAX as those of Python, and lists as tuples."""
    if not isinstance(x, str | int | float | list | tuple | None):
        x = np.asarray(x).tolist()
    return tuple(map(_plain, x)) if isinstance(x, list | tuple) else x


def _is_number(x: Any) -> bool:
    """Whether it is a finite number; a truth value is none."""
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= sys.float_info.max


def number(g: Any) -> Answer:
    """By how much the first is better, in the judge's own unit."""
    return Answer(form="number", value=g)


def choice(first: Any) -> Answer:
    """The first is better (True), or the second (False)."""
    return Answer(form="choice", value=2 * first - 1)  # what is neither is refused


def level(value: Any, levels: int) -> Answer:
    """One of so many levels: with five, -2 is much worse and 2 much better."""
    return Answer(form="level", value=value, levels=levels)


def slider(value: Any) -> Answer:
    """From -1, the second is as much better as can be, to 1."""
    return Answer(form="slider", value=value)


def ranking(order: Any) -> Answer:
    """The numbers of the clips, best first."""
    return Answer(form="ranking", value=order)


def rating(value: Any, levels: int) -> Answer:
    """How good a single clip is, against what was seen before."""
    return Answer(form="rating", value=value, levels=levels)


EQUALLY_GOOD = Answer(form="equal")
CANNOT_TELL = Answer(form="unsure")
