"""The linear world, whose optimum Riccati's recursion gives: regret over comparisons, and what is learned in the end.

Regret of a comparison is the optimal expected return minus the executed trajectory's. `gap` is how far the learned
policy's return is below the optimum, relative to it, over many fresh episodes; `optimal_gap` is the same for the
optimal stationary policy in the same episodes: what luck alone makes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.common import Report, parser
from benchmarks.runner import Job, add_running, folder, run_all, seeds_of

NEAR = 0.05


def gaps(path: Path, episodes: int, seed: int) -> tuple[float, float]:
    """Relative distance from the optimum of the learned policy and of the optimal one, in the same episodes."""
    import jax.random as jr
    import numpy as np

    from hiprl.api import load
    from hiprl.evaluate import episodes as roll_out
    from hiprl.evaluate import true_returns
    from hiprl.store.store import open_store
    from hiprl.world.linear import default_linear

    with open_store(path, create=False) as store:
        run = store.runs()[0].id
    learned, task = load(run, store=path), default_linear()
    optimum, key = task.optimal_return(), jr.key(10_000 + seed)
    means = [
        float(np.mean(true_returns(roll_out(learned.world, actor, episodes, key=key))))
        for actor in (learned.actor, task.optimal_actor())
    ]
    return (optimum - means[0]) / abs(optimum), (optimum - means[1]) / abs(optimum)


def main() -> None:
    """Runs what is missing and reports."""
    made = parser(__doc__)
    add_running(made, results="runs/benchmarks/linear.jsonl", seeds="0-4")
    made.add_argument("--presets", nargs="+", default=["default"], choices=("default", "paper"), help="settings")
    made.add_argument("--comparisons", type=int, default=30, help="answers that the judge gives")
    made.add_argument("--episodes", type=int, default=1000, help="fresh episodes to judge the learned policy by")
    options = made.parse_args()
    if options.quick:
        options.seeds, options.comparisons, options.episodes = "0", 6, 20
        options.results = options.results.with_name("linear-quick.jsonl")
    config = {"comparisons": options.comparisons}
    jobs = [
        Job(arm=preset, env="linear", seed=seed, settings={"preset": preset, "config": config})
        for seed in seeds_of(options.seeds)
        for preset in options.presets
    ]
    outcomes = run_all(jobs, results=options.results, workers=options.workers)

    from hiprl.evaluate import cumulative_regret
    from hiprl.world.linear import default_linear

    optimum = default_linear().optimal_return()
    report = Report(f"Linear world, {options.comparisons} comparisons; the optimum returns {optimum:.3f}")
    for job, outcome in outcomes:
        executed = [facts["true_return"] for facts in outcome["episodes"]]
        total = cumulative_regret(optimum, executed)
        third = max(1, len(executed) // 3)
        gap, luck = gaps(folder(options.results) / f"{job.name}.db", options.episodes, job.seed)
        found: dict[str, Any] = {
            "arm": job.arm,
            "seed": job.seed,
            "regret_first_third": float(total[third - 1]) / third,
            "regret_last_third": float(total[-1] - total[-third - 1]) / third,
            "cumulative": float(total[-1]),
            "gap": gap,
            "optimal_gap": luck,
            "near": "yes" if gap <= NEAR else "no",
            "wall_s": outcome["wall_seconds"],
        }
        report.add(**found)
    report.notes.append(f"near: within {NEAR:.0%} of the optimum. Regrets are a comparison's mean in each third.")
    report.show()
    report.write(options.json, seeds=seeds_of(options.seeds), optimum=optimum)


if __name__ == "__main__":
    main()
