"""Runs an outside simulator without its warnings on the screen or its log files in the user's folder."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Within it, Gymnasium's warnings are dropped and MuJoCo logs neither to the screen nor to a file.

    MuJoCo appends each warning to MUJOCO_LOG.TXT in the working folder; HalfCheetah's model alone causes one
    each time it is loaded. What MuJoCo warns of as it runs (an unstable simulation) shows in the states as
    well. The user's own warnings pass. What was set before is set again at the end.
    """
    before = _mujoco_log()
    if before is not None:
        silent = type(before).get()
        silent.logto_console, silent.logto_file = False, False
        silent.set()
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"gymnasium\b")
            # Gymnasium's logger blames its callers too; its messages start with a colour and "WARN:".
            warnings.filterwarnings("ignore", message=r"(\x1b\[\d+m)?WARN: ")
            yield
    finally:
        if before is not None:
            before.set()


def _mujoco_log():
    """MuJoCo's log settings; None without a MuJoCo that can be loaded."""
    try:
        from mujoco import MjLogConfig  # pyright: ignore[reportAttributeAccessIssue]
    except Exception:
        # With MUJOCO_GL=egl and no EGL library, importing it fails with errors of any kind. Worlds that need
        # MuJoCo then say so when they are made; the others must run.
        return None
    return MjLogConfig.get()
