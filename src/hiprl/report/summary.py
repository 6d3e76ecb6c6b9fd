"""The numbers of one run."""

from __future__ import annotations

import numpy as np

from hiprl.data.facts import foreseen
from hiprl.report.record import Facts, Record

RECENT = 10  # episodes behind a median
PARTS = ("propose", "judge", "learn", "practise")


def summary(record: Record) -> Facts:
    """What `hiprl show --json` prints but for the pictures; None where a number is not known.

    Returns, deviations and answers are in the units of the run's environment and judge.
    """
    final, row = record.final or {}, record.row
    last = record.episodes[-1] if record.episodes else {}
    seconds = {part: float(np.nansum(record.series(part, within="seconds"))) for part in PARTS}
    return {
        "run": record.id,
        "env": row.env,
        "seed": row.seed,
        "judge": row.spec["judge"],
        "begun": row.created_at.isoformat(timespec="seconds"),
        "finished": record.final is not None,
        "comparisons": record.answered,
        "planned_comparisons": record.planned,
        "env_steps": final.get("env_steps", last.get("env_steps", 0)),
        "return_mean": final.get("return_mean"),
        "return_std": final.get("return_std"),
        "eval_episodes": final.get("eval_episodes"),
        "best_executed_return": newest(record.best),
        "coverage": recent(record.series("coverage")),
        "beta": last.get("beta"),
        "kappa": last.get("kappa"),
        "alpha": last.get("alpha"),
        "worth": last.get("worth"),
        "deviation": recent(record.series("deviation")),
        "rollout_errors": {h: recent(record.series(h, within="rollout_errors")) for h in horizons(record)},
        "preference_deviation": recent(np.abs(record.series("g") - record.series("g_predicted"))),
        "right_signs": right_signs(record),
        "imagined": last.get("imagined"),
        "executed": last.get("executed"),
        "overpromised": int(np.nansum(record.series("overpromised"))),
        "seconds": seconds,
        "wall_seconds": final.get("wall_seconds", sum(seconds.values())),
        "versions": row.versions,
        "store": record.store,
        "episodes": record.episodes,
    }


def horizons(record: Record) -> list[str]:
    """The h of the h-step errors that were measured, in order."""
    measured = {h for episode in record.episodes for h in episode.get("rollout_errors") or {}}
    return sorted(measured, key=int)


def right_signs(record: Record) -> float | None:
    """Share of the answers in the episodes with a policy whose side r̂ had foreseen."""
    share, told = foreseen(one for one in record.episodes if one.get("searched"))
    return share if told else None


def recent(series: np.ndarray) -> float | None:
    """Median of the newest numbers that are known."""
    known = series[np.isfinite(series)][-RECENT:]
    return float(np.median(known)) if len(known) else None


def newest(series: np.ndarray) -> float | None:
    """The newest number that is known."""
    known = series[np.isfinite(series)]
    return float(known[-1]) if len(known) else None
