"""What an entry point sets for the machine that it runs on: where compiled programs are kept."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

SLOW_TO_COMPILE = "0.5"  # seconds; a program that takes longer is kept


def prepare() -> None:
    """Keeps compiled programs and Matplotlib's list of fonts in the user's cache folder, if it can be written.

    To be called before JAX or Matplotlib is imported. What the user has set stays.
    """
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache entry")
    folder = cache_folder()
    if folder is None:
        return
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", SLOW_TO_COMPILE)
    os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))


def cache_folder() -> Path | None:
    """`hiprl` in the user's cache folder, made if there is none; None if it cannot be written."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    try:
        folder = (Path(home) if Path(home).is_absolute() else Path.home() / ".cache") / "hiprl"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: nobody knows this user's home
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None
