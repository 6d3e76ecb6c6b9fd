"""How a run was set up, in few words: the preset that it is nearest to, and where it departs from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from hiprl.config import PRESETS, asking, preset, teachable
from hiprl.feedback.judges import judge_from
from hiprl.spec import to_plain
from hiprl.store.rows import CUSTOM, PEOPLE, RunRow


class Setting(NamedTuple):
    """A run's settings but for the seed."""

    env: str
    preset: str
    """The nearest one, of this version of hiprl."""
    changes: dict[str, str]
    """Field to value, where the run departs from that preset, and the judge."""

    def words(self, *, most: int | None = None) -> str:
        """The preset and the changes in one line; no more than `most` of them."""
        changes = [f"{name} {value}" for name, value in self.changes.items()]
        more = 0 if most is None else len(changes) - most
        return ", ".join([self.preset, *changes[:most], *([f"and {more} more"] if more > 0 else [])])


def setting(row: RunRow) -> Setting:
    """The settings in a run's row."""
    spec, stored = row.spec, flat(row.spec["config"])
    nearest, changes = min(
        ((name, departures(flat(of_preset(name, row)), stored)) for name in PRESETS), key=lambda found: len(found[1])
    )
    if spec["judge"] != "exact":
        changes = {"judge": spec.get("function") or spec["judge"], **changes}
    return Setting(row.env, nearest, changes)


def of_preset(name: str, row: RunRow) -> Mapping[str, Any]:
    """The preset as plain values, with as many comparisons as the run."""
    config, K = preset(name, row.env), row.spec["config"]["comparisons"]
    config = replace(config, comparisons=K, warm_up=min(config.warm_up, K))
    if row.spec["judge"] == PEOPLE:
        config = teachable(config)
    elif row.spec["judge"] != CUSTOM:
        config = asking(config, judge_from(row.spec["judge"]))
    return to_plain(config)


def departures(usual: Mapping[str, str], stored: Mapping[str, str]) -> dict[str, str]:
    """Fields whose values differ. Of a part that is another one altogether only its name is told."""
    changed = {name: value for name, value in stored.items() if usual.get(name) != value}
    parts = [name for name in changed if stored.get(f"{name}.part") != usual.get(f"{name}.part")]
    return {
        name: value
        for name, value in changed.items()
        if not any(name.startswith(f"{part}.") for part in parts) and not name.endswith(".part")
    }


def flat(plain: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested settings as one level of dotted names, all values as text. A part stands under its name as well."""
    found: dict[str, str] = {}
    for name, value in plain.items():
        if isinstance(value, Mapping):
            found[prefix + name] = str(value["part"]).removesuffix("Config").lower()
            found |= flat(value, f"{prefix}{name}.")
        elif name == "kind" and prefix:  # what `--plan` says
            found[prefix.removesuffix(".")] = str(value)
        elif name != "part" or prefix:
            found[prefix + name] = f"{value:g}" if isinstance(value, float) else str(value)
    return found
