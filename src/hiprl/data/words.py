"""What people type of their own: names and goals."""

from __future__ import annotations

JOINERS = "\u200c\u200d"
"""Cannot be seen, and belong into words: of Persian, and between the parts of an emoji."""


def seen_of(words: str) -> str:
    """The words without what joins their letters."""
    return "".join(sign for sign in words if sign not in JOINERS)


def hidden_in(words: str) -> str | None:
    """The first sign that cannot be seen and belongs into no word; None if there is none."""
    return next((sign for sign in seen_of(words) if not sign.isprintable()), None)
