"""What the facts of several episodes say together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

LITTLE = 0.01  # share of what was learned: an answer worth less is hardly worth giving
IN_A_ROW = 3  # such answers, until that is said


def enough(facts: Iterable[Mapping[str, Any]]) -> bool:
    """Whether the last answers were hardly worth giving: none was expected to change what is wanted by much."""
    known = [one for one in facts if one.get("worth") is not None]
    after = {one.get("comparisons", one["k"]): one["worth"] for one in known}  # episodes between answers are no answers
    newest = list(after.values())[-IN_A_ROW:]
    return len(newest) == IN_A_ROW and max(newest) < LITTLE
