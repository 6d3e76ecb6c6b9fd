"""Teaches an agent a behaviour from a few comparisons between things it did, with no reward function.

    from hiprl import learn, Judge, World

Everything here is loaded when it is first used: importing hiprl is quick and sets nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hiprl.api import Learned, learn, load, resume
    from hiprl.config import Config, preset
    from hiprl.data.answer import Answer
    from hiprl.data.trajectory import Trajectory
    from hiprl.errors import FitDiverged, HiprlError, InputError, JudgeError, StoreError, WorldError
    from hiprl.feedback.judging import Judge
    from hiprl.world.build import world_from
    from hiprl.world.task import World

_HOMES = {
    "Learned": "hiprl.api",
    "learn": "hiprl.api",
    "load": "hiprl.api",
    "resume": "hiprl.api",
    "Config": "hiprl.config",
    "preset": "hiprl.config",
    "Answer": "hiprl.data.answer",
    "Trajectory": "hiprl.data.trajectory",
    "FitDiverged": "hiprl.errors",
    "HiprlError": "hiprl.errors",
    "InputError": "hiprl.errors",
    "JudgeError": "hiprl.errors",
    "StoreError": "hiprl.errors",
    "WorldError": "hiprl.errors",
    "Judge": "hiprl.feedback.judging",
    "world_from": "hiprl.world.build",
    "World": "hiprl.world.task",
}

__all__ = [
    "Answer",
    "Config",
    "FitDiverged",
    "HiprlError",
    "InputError",
    "Judge",
    "JudgeError",
    "Learned",
    "StoreError",
    "Trajectory",
    "World",
    "WorldError",
    "learn",
    "load",
    "preset",
    "resume",
    "world_from",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'hiprl' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
