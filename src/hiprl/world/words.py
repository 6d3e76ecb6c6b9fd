"""How messages name what was found: a value, an error, the names close to a wrong one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


def described(value: Any) -> str:
    """A value's class and the start of its text."""
    text = " ".join(repr(value).split())
    return f"{type(value).__module__}.{type(value).__qualname__} {text[:60]}{'…' if len(text) > 60 else ''}"


def said(error: Exception) -> str:
    """An error's class and the first line of what it says, without a full stop."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0].rstrip('.')}" if lines else type(error).__name__


def near(name: str, names: Iterable[str]) -> str:
    """A question with the names closest to `name`, whatever their case; empty if none is close."""
    by_lower = {known.lower(): known for known in sorted(names)}
    close = difflib.get_close_matches(name.lower(), by_lower, n=3, cutoff=0.6)
    return f"Did you mean {' or '.join(by_lower[n] for n in close)}? " if close else ""
