"""A run as a row of plain values: enough to do it again."""

from __future__ import annotations

import dataclasses
import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, TypeVar

from hiprl.config import Config
from hiprl.control.gradient import GradientConfig
from hiprl.control.plan import PlanConfig
from hiprl.control.ppo import PPOConfig
from hiprl.errors import StoreError
from hiprl.feedback.questions import QuestionConfig
from hiprl.models.dynamics import DynamicsConfig
from hiprl.models.reward import AdditiveConfig
from hiprl.models.reward_network import NetworkConfig

_PARTS = {
    part.__name__: part
    for part in (
        Config,
        GradientConfig,
        PPOConfig,
        PlanConfig,
        QuestionConfig,
        DynamicsConfig,
        AdditiveConfig,
        NetworkConfig,
    )
}
Part = TypeVar("Part")


def to_plain(config: Any) -> Any:
    """A config as dictionaries, lists and numbers, each part with its name."""
    if dataclasses.is_dataclass(config):
        fields = {field.name: to_plain(getattr(config, field.name)) for field in dataclasses.fields(config)}
        return {"part": type(config).__name__, **fields}
    return list(config) if isinstance(config, tuple) else config


def from_plain(plain: Any) -> Any:
    """The config that `to_plain` was given.

    Raises:
        StoreError: it has what this version of hiprl does not know, or leaves open what needs a value.
    """
    if isinstance(plain, Mapping):
        name, settings = plain["part"], {name: from_plain(value) for name, value in plain.items() if name != "part"}
        part = _PARTS.get(name)
        strange = [f"{name} is unknown"] if part is None else strange_in(settings, part)
        if part is None or strange:
            raise StoreError(
                f"the run's settings are those of another version of hiprl: {', '.join(strange)}. "
                f"Go on with the version that made the run, or begin a new one with this, hiprl {version('hiprl')}."
            )
        return part(**settings)
    return tuple(plain) if isinstance(plain, list) else plain


def strange_in(settings: Mapping[str, Any], part: type[Any]) -> list[str]:
    """What is wrong with the settings of a part: those that it does not have, and those that need a value."""
    types = {field.name: str(field.type) for field in dataclasses.fields(part)}
    unknown = [f"{name} is unknown" for name in settings if name not in types]
    missing = [name for name, value in settings.items() if value is None and "None" not in types.get(name, "None")]
    return sorted([*unknown, *(f"{name} has no value" for name in missing)])


def versions() -> dict[str, str]:
    """Of everything that a draw or a sum depends on."""
    names = ("hiprl", "jax", "jaxlib", "equinox", "optax", "numpy", "gymnasium", "mujoco")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
