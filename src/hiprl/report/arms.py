"""Runs side by side: those that differ in their seed alone are one arm."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hiprl.evaluate import Interval, interval
from hiprl.report.record import Facts, Record
from hiprl.report.setting import setting
from hiprl.store.rows import CUSTOM, PEOPLE

NEAR = 0.9  # of the way from random actions to the best arm counts as there
CURVE_DRAWS = 500  # of the bootstrap, at each point of a curve


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """Runs with the same settings."""

    name: str
    """What sets it apart from the other arms in its environment."""
    runs: list[Record]
    """Oldest first."""

    @property
    def env(self) -> str:
        """Of all its runs."""
        return self.runs[0].row.env

    @property
    def finished(self) -> list[Record]:
        """The runs that count for the final return."""
        return [run for run in self.runs if returned(run) is not None]

    def final_returns(self) -> np.ndarray:
        """Mean return of each finished run's policy."""
        return np.array([returned(run) for run in self.finished], float)

    def final_return(self) -> Interval | None:
        """The same over runs; None if no run is finished."""
        returns = self.final_returns()
        return interval(returns) if len(returns) else None

    def curve(self) -> tuple[np.ndarray, list[Interval]]:
        """Comparisons, and interval over runs of the true return of the policy that r̂ ranks best by then.

        Over the finished runs, or over all if none is; to the end of the shortest.
        """
        runs = self.finished or self.runs
        end = min(run.k[-1] if len(run.k) else 0.0 for run in runs)
        k = np.unique(np.concatenate([run.k for run in runs]))
        k = k[k <= end]
        best = np.stack([run.best_after(k) for run in runs])
        known = np.isfinite(best).all(axis=0)
        return k[known], [interval(column, draws=CURVE_DRAWS) for column in best.T[known]]


def returned(run: Record) -> float | None:
    """The mean return of a finished run's policy, if the environment pays."""
    return None if run.final is None else run.final["return_mean"]


def arms_of(records: Iterable[Record]) -> list[Arm]:
    """The arms by environment, in the order in which their first runs were begun.

    A run named twice counts once, and so do runs of the same seed that nobody but a script has judged: of these the
    finished one, or the newest. Runs of different versions of hiprl are no such runs, and no one arm.
    """
    groups: dict[str, list[Record]] = {}
    once = {(record.store, record.id): record for record in records}
    for record in sorted(once.values(), key=lambda record: (record.row.created_at, record.id)):
        spec = {"function": None, **record.row.spec}  # which earlier runs do not say
        same = json.dumps([record.row.env, spec, record.goal, version_of(record)], sort_keys=True)
        groups.setdefault(same, []).append(record)
    for same, runs in groups.items():
        if runs[0].row.spec["judge"] not in (PEOPLE, CUSTOM):
            by_seed = {run.row.seed: run for run in sorted(runs, key=lambda run: run.final is not None)}
            groups[same] = [run for run in runs if by_seed[run.row.seed] is run]
    arms: list[Arm] = []
    for env in dict.fromkeys(runs[0].row.env for runs in groups.values()):
        here = [runs for runs in groups.values() if runs[0].row.env == env]
        names = names_of([runs[0] for runs in here])
        arms += [Arm(name=name, runs=runs) for name, runs in zip(names, here, strict=True)]
    return arms


def version_of(run: Record) -> str:
    """Of the hiprl that a run was made by."""
    return run.row.versions.get("hiprl", "")


def names_of(firsts: Sequence[Record]) -> list[str]:
    """For each of these runs in one environment, what sets it apart from the others; all different."""
    settings = [setting(record.row) for record in firsts]
    shared = set.intersection(*({*one.changes.items()} for one in settings)) if settings else set()
    many_presets = len({one.preset for one in settings}) > 1
    names = []
    for record, one in zip(firsts, settings, strict=True):
        apart = [f"{field} {value}" for field, value in one.changes.items() if (field, value) not in shared]
        if len({other.planned for other in firsts}) > 1:
            apart.append(f"{record.planned} comparisons")
        if len({version_of(other) for other in firsts}) > 1:
            apart.append(f"hiprl {version_of(record)}")
        if record.goal and len({other.goal for other in firsts}) > 1:
            apart.append(f'"{record.goal}"')
        names.append(", ".join(([one.preset] if many_presets or not apart else []) + apart))
    seen = Counter[str]()
    for i, name in enumerate(names):
        seen[name] += 1
        if seen[name] > 1:  # they differ in what has no short name, such as the horizon
            names[i] = f"{name} ({seen[name]})"
    return names


def compared(arms: Sequence[Arm], *, reach: float | None = None) -> list[Facts]:
    """One line of numbers an arm.

    Args:
        arms: to be compared.
        reach: the true return to reach; by default nine tenths of the way from random actions to the best arm of
            the same environment.
    """
    return [line(arm, reach if reach is not None else goal(arms, arm.env)) for arm in arms]


def line(arm: Arm, reach: float | None) -> Facts:
    """The numbers of one arm; `comparisons_needed` is the median over the runs that reached the return."""
    returns, middle = arm.final_returns(), arm.final_return()
    needed = [k for k in (first_at(run, reach) for run in arm.runs) if k is not None]
    spread = len(returns) > 1
    return {
        "arm": arm.name,
        "env": arm.env,
        "runs": [run.id for run in arm.runs],
        "seeds": [run.row.seed for run in arm.runs],
        "finished": len(arm.finished),
        "return_iqm": middle.mean if middle else None,
        "return_low": middle.low if middle and spread else None,
        "return_high": middle.high if middle and spread else None,
        "return_min": float(returns.min()) if len(returns) else None,
        "return_max": float(returns.max()) if len(returns) else None,
        "reach": reach,
        "reached": len(needed),
        "comparisons_needed": float(np.median(needed)) if needed else None,
        "wall_seconds": float(np.median([run.final["wall_seconds"] for run in arm.finished if run.final]))
        if arm.finished
        else None,
    }


def goal(arms: Sequence[Arm], env: str) -> float | None:
    """Nine tenths of the way from the return of random actions to that of the best arm."""
    here = [arm for arm in arms if arm.env == env]
    random = np.concatenate([run.executed[~run.searched] for arm in here for run in arm.runs])
    random = random[np.isfinite(random)]
    best = [end.mean for arm in here if (end := arm.final_return()) is not None]
    if not best or not len(random):
        return None
    return float(random.mean() + NEAR * (max(best) - random.mean()))


def first_at(run: Record, reach: float | None) -> int | None:
    """The comparisons after which the policy that r̂ ranks best has reached the return."""
    if reach is None:
        return None
    there = run.k[run.best >= reach]
    return int(there[0]) if len(there) else None
