"""What each kind of answer teaches: returns over seeds, by judge and by how questions are picked.

The default preset with judges that say less than the exact difference of two returns. Arms of HalfCheetah-v5:

  numeric    the exact difference of two whole episodes (the paper's judge)
  levels     one of five levels, about clips of 50 steps
  choice     which of two clips of 50 steps is better
  mistaken   the same, wrong in one answer out of ten
  uniform    choices about clips that are picked uniformly, the newest trajectory against any older one
  whole      choices about whole episodes that are picked uniformly

As by default, an episode of practice follows each answer that is no number, so that these arms search twice for each
answer, and execute 26 episodes more in a run of 30.

A run has as many comparisons as the greatest of --after; what it would have reported after fewer is read off on the
way: the executed return of the policy that r̂ ranked best by then. Hopper-v5 and Walker2d-v5 have numbers only, beside
REDQ's published returns after as many steps with the true reward (Chen et al., 2021: 1661 and 599 at 30,000).
"""

from __future__ import annotations

import argparse
from typing import Any

from benchmarks.common import Report, parser
from benchmarks.runner import Job, Outcome, add_running, by_arm, run_all, seeds_of, spread

CHEETAH = "HalfCheetah-v5"
ARMS: dict[str, dict[str, Any]] = {
    "numeric": {},
    "levels": {"judge": "graded", "practice": 1},
    "choice": {"judge": "choice", "practice": 1},
    "mistaken": {"judge": "choice:mistake=0.1", "practice": 1},
    "uniform": {"judge": "choice", "practice": 1, "ask": "uniform"},
    "whole": {"judge": "choice", "practice": 1, "ask": "uniform", "clip": 0},
}
REDQ = {"Hopper-v5": 1661.0, "Walker2d-v5": 599.0}
"""Mean return after 30,000 steps, with the true reward (Chen et al., 2021)."""


def jobs_of(options: argparse.Namespace) -> list[Job]:
    """All runs, seeds outermost."""
    K = max(options.after)
    config = {"comparisons": K, "warm_up": min(5, K)}
    made = []
    for seed in seeds_of(options.seeds):
        for env in options.envs:
            arms = options.arms if env == CHEETAH else ["numeric"]
            made += [Job(arm=arm, env=env, seed=seed, settings=ARMS[arm] | {"config": config}) for arm in arms]
    return made


def row(env: str, arm: str, outcomes: list[tuple[Job, Outcome]], after: list[int]) -> dict[str, Any]:
    """One line of the table."""
    found: dict[str, Any] = {"env": env, "arm": arm, **spread([outcome["return_mean"] for _, outcome in outcomes])}
    for k in after:
        reported = [outcome["reported"][k - 1] for _, outcome in outcomes]
        known = [x for x in reported if x is not None]
        found[f"after {k}"] = sum(known) / len(known) if known else None
    found["env_steps"] = max(outcome["env_steps"] for _, outcome in outcomes)
    found["right_side"] = mean_of(outcomes, "foreseen")
    if env in REDQ:
        found["REDQ"] = REDQ[env]
    return found


def mean_of(outcomes: list[tuple[Job, Outcome]], name: str) -> float | None:
    """Mean of a fact over all episodes of all runs that have it."""
    values = [facts[name] for _, outcome in outcomes for facts in outcome["episodes"] if facts.get(name) is not None]
    return sum(values) / len(values) if values else None


def main() -> None:
    """Runs what is missing and reports."""
    made = parser(__doc__)
    add_running(made, results="runs/benchmarks/answers.jsonl", seeds="30-34")
    made.add_argument("--envs", nargs="+", default=[CHEETAH, *REDQ], help="environments")
    made.add_argument("--arms", nargs="+", default=list(ARMS), choices=ARMS, help="judges and questions")
    made.add_argument("--after", nargs="+", type=int, default=[10, 20, 30], help="comparisons after which to look")
    options = made.parse_args()
    if options.quick:
        options.seeds, options.after, options.envs = "0", [6], ["InvertedPendulum-v5"]
        options.results = options.results.with_name("answers-quick.jsonl")
    outcomes = run_all(jobs_of(options), results=options.results, workers=options.workers)
    report = Report(f"Returns after {max(options.after)} answers, by who answers and what is asked")
    for (env, arm), group in by_arm(outcomes).items():
        report.add(**row(env, arm, group, options.after))
    report.notes.append(
        "right_side: share of the answers whose side r̂ had foreseen. after k: mean executed return of the policy that "
        "would then have been reported; the return itself is that of ten fresh episodes of the last one."
    )
    report.show()
    report.write(options.json, seeds=seeds_of(options.seeds))


if __name__ == "__main__":
    main()
