"""Judges that answer by rule: the true return, exact or with an error, and any function of two trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias, cast

import jax.random as jr
import numpy as np

from hiprl.data.preference import gap
from hiprl.data.trajectory import Trajectory
from hiprl.errors import InputError, JudgeError
from hiprl.types import Key

Judge: TypeAlias = Callable[[Trajectory, Trajectory], float]
"""By how much the first trajectory is better than the second; negative where it is worse.

Gets both without padding, as NumPy arrays: `tau.states` (n + 1, p), `tau.actions` (n, q) in [-1, 1].
"""
Answer: TypeAlias = Callable[..., float]
"""A judge inside hiprl: (tau, other, *, key) to g."""


def exact(tau: Trajectory, other: Trajectory, *, key: Key) -> float:
    """The difference of the true returns, as the paper's judge gives it."""
    return float(gap(tau, other))


def noisy(std: float) -> Answer:
    """The exact answer with a Gaussian error of this standard deviation, in the unit of the return."""

    def answer(tau: Trajectory, other: Trajectory, *, key: Key) -> float:
        return float(gap(tau, other)) + std * float(jr.normal(key))

    return answer


def judge_from(judge: Any) -> Answer:
    """A judge from `exact`, `noisy:STD`, or a function of two trajectories.

    Raises:
        InputError: no judge of that name, or a setting that is not a number.
    """
    if callable(judge):
        return lambda tau, other, *, key: cast(float, judge(tau.seen(), other.seen()))
    name, _, setting = judge.partition(":") if isinstance(judge, str) else ("", "", "")
    if name == "exact" and not setting:
        return exact
    if name == "noisy":
        try:
            std = float(setting)
        except ValueError:
            std = math.nan
        if std >= 0 and math.isfinite(std):
            return noisy(std)
    raise InputError(
        f"got the judge {judge!r}; a scripted judge is `exact` or `noisy:STD` with STD the error of an answer in "
        "the unit of the return, 0 or more. Say for example `--judge noisy:50`, or pass a function from Python."
    )


def checked(answer: Answer, tau: Trajectory, other: Trajectory, *, key: Key) -> float:
    """Asks, and sees to it that the answer is a number.

    Raises:
        JudgeError: the judge raised, or gave no finite number. The question stays open.
    """
    try:
        g = answer(tau, other, key=key)
    except Exception as e:
        raise JudgeError(
            f"the judge raised {type(e).__name__}: {e}; it has to give one number for two trajectories. "
            "Mend the judge and resume the run: the question is still open."
        ) from e
    number = _number(g)
    if number is None:
        raise JudgeError(
            f"the judge answered {g!r}; one finite number is needed, positive where the first trajectory is better. "
            "Mend the judge and resume the run: the question is still open. (An environment that pays no reward "
            "needs a judge of your own.)"
        )
    return number


def _number(g: object) -> float | None:
    """The answer, if it is one finite number; a truth value or a text is none."""
    try:
        x = np.asarray(g)
    except ValueError:  # lists of different lengths
        return None
    return float(x) if x.shape == () and x.dtype.kind in "iuf" and np.isfinite(x) else None
