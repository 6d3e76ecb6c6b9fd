"""What the facts of several episodes say together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

LITTLE = 0.01  # share of what was learned: an answer worth less is hardly worth giving
IN_A_ROW = 3  # such answers, until that is said


def foreseen(facts: Iterable[Mapping[str, Any]], *, recent: int | None = None) -> tuple[float, float]:
    """Share of the answers whose side r̂ had foreseen, and how many answers these are; of the most recent ones.

    The fact of an episode is a share as well, of those that came since the episode before.
    """
    known = [(one["foreseen"], one.get("told", 1)) for one in facts if one.get("foreseen") is not None]
    right = total = 0.0
    for share, told in reversed(known):
        count = told if recent is None else min(told, recent - total)
        right, total = right + share * count, total + count
    return (right / total if total else math.nan), total


def enough(facts: Iterable[Mapping[str, Any]]) -> bool:
    """Whether the last answers were hardly worth giving: none was expected to change what is wanted by much."""
    known = [one for one in facts if one.get("worth") is not None]
    after = {one.get("comparisons", one["k"]): one["worth"] for one in known}  # episodes between answers are no answers
    newest = list(after.values())[-IN_A_ROW:]
    return len(newest) == IN_A_ROW and max(newest) < LITTLE
