"""What people type of their own: names and goals."""

from __future__ import annotations

from typing import Any

from hiprl.errors import InputError

LONGEST_NAME, LONGEST_GOAL = 60, 500  # letters

JOINERS = "\u200c\u200d"
"""Cannot be seen, and belong into words: of Persian, and between the parts of an emoji."""


def seen_of(words: str) -> str:
    """The words without what joins their letters."""
    return "".join(sign for sign in words if sign not in JOINERS)


def hidden_in(words: str) -> str | None:
    """The first sign that cannot be seen and belongs into no word; None if there is none."""
    return next((sign for sign in seen_of(words) if not sign.isprintable()), None)


def name_in(given: Any) -> str:
    """The name of who answers.

    Raises:
        InputError: it is none.
    """
    return _one_line(given, LONGEST_NAME, "who answers")


def goal_in(given: Any) -> str:
    """What is wanted.

    Raises:
        InputError: it cannot be read.
    """
    return _one_line(given, LONGEST_GOAL, "what is wanted")


def _one_line(given: Any, longest: int, what: str) -> str:
    """Somebody's own words, on one line, with a space wherever there was any."""
    words = " ".join(given.split()) if isinstance(given, str) else ""
    hidden = hidden_in(words)
    if hidden is not None:
        raise InputError(f"Say {what} without the sign U+{ord(hidden):04X}, which cannot be seen.")
    if not seen_of(words) or len(words) > longest:
        raise InputError(f"Say {what} in 1 to {longest} letters.")
    return words
