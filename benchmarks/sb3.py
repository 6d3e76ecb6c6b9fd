"""Where Stable-Baselines3 lives: an environment of its own, as Torch is large and hiprl does not need it."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

from benchmarks.common import progress

HERE = Path(__file__).parent
HOME = HERE / ".venv-sb3"
PINS = HERE / "sb3-requirements.txt"


def sb3_python() -> str:
    """The Python that has Stable-Baselines3; it is installed on first use (about 1 GB, a minute or two)."""
    python = HOME / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done = HOME / ".installed"
    if done.exists() and done.read_text() == PINS.read_text():
        return str(python)
    progress(f"Installing Stable-Baselines3 into {HOME.relative_to(HERE.parent)}")
    venv.create(HOME, with_pip=True)
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", PINS]
    if subprocess.run(install, stdout=sys.stderr, check=False).returncode:
        raise SystemExit(f"could not install {PINS.name}; without it, --no-sb3 leaves Stable-Baselines3 out")
    done.write_text(PINS.read_text())
    return str(python)
