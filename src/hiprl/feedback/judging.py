"""What a judge is, and what is asked of one: an answer, and one that fits the clips shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from hiprl.data.answer import LARGEST, Answer, Form, number
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import JudgeError
from hiprl.types import Key

Judge: TypeAlias = Callable[..., float | Answer]
"""A function of the clips shown: two trajectories, one for a rating, k for a ranking.

It says by how much the first is better (a number, negative where it is worse), or gives an `Answer`. Gets the clips
without padding, as NumPy arrays: `tau.states` (n + 1, p), `tau.actions` (n, q) in [-1, 1].
"""


@dataclass(frozen=True, kw_only=True)
class Judging:
    """A judge inside hiprl, and what it has to be shown."""

    answer: Callable[..., Any]
    """(clips, hand, *, steps, key) to an answer. Asked by `checked`, which says what they are."""
    form: Form | None = None
    """What it answers with, but for `equal` and `unsure`; None for a function of one's own."""
    items: int = 2
    """How many clips it needs to see."""
    levels: int | None = None
    """How many there are, for `level` and `rating`."""


def checked(
    judging: Judging, clips: tuple[Trajectory, ...], hand: Trajectories, *, steps: int | None = None, key: Key
) -> Answer:
    """Asks, and sees to it that the answer is one, and about the clips shown. A bare number becomes an `Answer`.

    Args:
        judging: the judge.
        clips: what is shown.
        hand: all trajectories that there are.
        steps: of a clip that does not end before; None for those of the longest shown.
        key: of the judge's draws.

    Raises:
        JudgeError: the judge raised, or gave no usable answer. The question stays open.
    """
    try:
        given = judging.answer(clips, hand, steps=steps, key=key)
    except Exception as e:
        raise JudgeError(
            f"the judge raised {type(e).__name__}: {e}; it has to give one number for two trajectories, or an Answer. "
            "Mend the judge and resume the run: the question is still open."
        ) from e
    if not isinstance(given, Answer) or given.form == "number":
        g = _number(given.value if isinstance(given, Answer) else given)
        if g is None:
            raise JudgeError(
                f"the judge answered {given!r}; one number is needed, positive where the first trajectory is better "
                f"and at most {LARGEST:g} either way, or an Answer. Mend the judge and resume the run: the question is "
                "still open. (An environment that pays no reward needs a judge of your own, or people: `hiprl teach`.)"
            )
        given = number(g)
    if given.form != "unsure" and given.items != len(clips):
        raise JudgeError(
            f"the judge answered {given.value!r} of the form {given.form!r}, and the number of clips shown was "
            f"{len(clips)}; a rating is about one clip, a ranking names each that is shown, and any other answer is "
            "about two. Mend the judge and resume the run: the question is still open."
        )
    return given


def _number(g: object) -> float | None:
    """The answer, if it is one number that can be learned from; a truth value or a text is none."""
    try:
        x = np.asarray(g)
    except ValueError:  # lists of different lengths
        return None
    return float(x) if x.shape == () and x.dtype.kind in "iuf" and abs(x) <= LARGEST else None
