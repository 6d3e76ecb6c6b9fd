"""A run as the store tells it: its row, the facts of its episodes, its summary if it is finished."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from hiprl.errors import InputError
from hiprl.store.rows import RunRow
from hiprl.store.store import Store

Facts: TypeAlias = dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """What is known of a run. A number that was not known when it was written is None in facts, NaN in series."""

    row: RunRow
    episodes: list[Facts]
    """The facts of each finished episode, in order."""
    final: Facts | None
    """The summary; None while the run is not finished."""
    store: str
    goal: str = ""
    """What people say it is to learn, in their words."""

    @property
    def id(self) -> str:
        """Of the run."""
        return self.row.id

    @property
    def planned(self) -> int:
        """K, the comparisons that the run was to have."""
        return self.row.spec["config"]["comparisons"]

    @property
    def answered(self) -> int:
        """How many comparisons were answered by its end, or by its newest episode."""
        last = int(self.episodes[-1].get("comparisons", 0)) if self.episodes else 0
        return last if self.final is None else int(self.final.get("comparisons", last))

    def series(self, name: str, *, within: str | None = None) -> np.ndarray:
        """One number an episode, from its facts; `within` names the facts inside them that hold it."""
        facts = self.episodes if within is None else [episode.get(within) or {} for episode in self.episodes]
        return np.array([np.nan if one.get(name) is None else float(one[name]) for one in facts])

    @property
    def k(self) -> np.ndarray:
        """The comparisons that had been answered after each episode."""
        return self.series("comparisons")

    @property
    def searched(self) -> np.ndarray:
        """True where the episode had a policy; False in the warm-up."""
        return self.series("searched") == 1

    @property
    def executed(self) -> np.ndarray:
        """True return of each episode."""
        return self.series("true_return")

    @property
    def best(self) -> np.ndarray:
        """True return of the policy's episode that r̂ ranked best at that time; NaN in the warm-up."""
        return self.series("best_return")

    def best_after(self, k: np.ndarray) -> np.ndarray:
        """The same after so many comparisons each; between two there may be several episodes, or none."""
        at = np.searchsorted(self.k, k, side="right") - 1
        return np.where(at < 0, np.nan, self.best[np.maximum(at, 0)]) if len(self.episodes) else np.full(len(k), np.nan)

    @property
    def surprise(self) -> np.ndarray:
        """|g - ĝ| / σ_g of each answer, predicted before it came."""
        sigma = np.maximum(self.series("sigma_g"), 1e-12)
        return np.abs(self.series("g") - self.series("g_predicted")) / sigma

    @property
    def pays(self) -> bool:
        """Whether the environment pays a reward at all."""
        return bool(np.isfinite(self.executed).any())


def record(store: Store, row: RunRow) -> Record:
    """What the store knows of a run."""
    facts = [facts for _, facts in store.episodes(row.id)]
    return Record(row=row, episodes=facts, final=store.final(row.id), store=store.name, goal=store.goal(row.id) or "")


def newest(store: Store) -> RunRow:
    """The run that was begun last.

    Raises:
        InputError: the store has none.
    """
    rows = store.runs()
    if not rows:
        raise InputError(
            f"there is no run in {store.name} yet; one is needed to look at. "
            "Begin one with `hiprl train`, or name another store with --store."
        )
    return rows[-1]


def beside(store: str, name: str) -> Path:
    """A folder of this name beside a store's file; in `runs` for a database."""
    return Path("runs" if "://" in store else Path(store).expanduser().parent) / name
