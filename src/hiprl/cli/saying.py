"""Words for a person, which go to stderr: stdout is for what a program reads."""

from __future__ import annotations

import sys

CLEARED = "\r\x1b[K"  # what a terminal begins a line anew by


def say(words: str) -> None:
    """Words for a person; on a terminal in place of the line that a trainer keeps up to date there."""
    print(CLEARED * sys.stderr.isatty() + words, file=sys.stderr, flush=True)
