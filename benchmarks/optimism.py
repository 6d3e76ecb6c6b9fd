"""Optimism against greed: pendulum swing-up with a narrow reward and a price on torque.

A policy that does nothing gets 0; whoever tries and misses the top gets less. `solved_at`: after how many episodes
the policy that would be reported had swung up, that is, returned more than half of what the best of all runs did.

With `--reward known` the learner knows the reward, and what is left is to explore the world; with `--reward answers` it
learns the reward from a judge's numbers as usual, and cannot want to go where nobody has been.

All modes have the same settings, found in the true model and then on seeds 100 and 101: `KAPPA`, which only
`eta_policy` and `eta_sign` heed, and `SEARCH`. Seeds 0 and 5 were looked at on the way.
"""

from __future__ import annotations

from typing import Any

from benchmarks.common import Report, parser
from benchmarks.runner import Job, Outcome, add_running, by_arm, run_all, seeds_of, spread

REWARDS = ("known", "answers")
KAPPA = 3.0  # near the bottom the models are surer than they need be, so that beta is at its least
SEARCH = {"part": "GradientConfig", "steps": 10, "rollouts": 50, "policy_rate": 1e-3}
ARMS = ("greedy", "thompson", "eta_policy", "eta_sign", "bonus")


def solved_at(reported: list[float | None], enough: float) -> int | None:
    """After how many episodes a reported policy first returned `enough`."""
    return next((k for k, value in enumerate(reported, start=1) if value is not None and value >= enough), None)


def row(arm: str, outcomes: list[tuple[Job, Outcome]], best: float) -> dict[str, Any]:
    """One line of the table."""
    returns = [outcome["return_mean"] for _, outcome in outcomes]
    solved = [solved_at(outcome["reported"], best / 2) for _, outcome in outcomes] if best > 0 else []
    return {
        "arm": arm,
        **spread(returns),
        "solved": sum(value > best / 2 > 0 for value in returns),
        "solved_at": ", ".join("never" if k is None else str(k) for k in solved),
        "wall_s": sum(outcome["wall_seconds"] for _, outcome in outcomes) / len(outcomes),
    }


def main() -> None:
    """Runs what is missing and reports."""
    made = parser(__doc__)
    add_running(made, results="runs/benchmarks/optimism.jsonl", seeds="10-19")
    made.add_argument("--arms", nargs="+", default=list(ARMS), choices=ARMS, help="modes compared")
    made.add_argument("--action-cost", type=float, default=0.1, help="what a full torque costs a step")
    made.add_argument("--reward", nargs="+", choices=REWARDS, default=list(REWARDS), help="what it knows of the reward")
    made.add_argument("--episodes", type=int, default=15, help="of a run, each with a comparison if there is a judge")
    options = made.parse_args()
    if options.quick:
        options.seeds, options.episodes, options.arms = "0", 6, ["greedy", "thompson"]
        options.results = options.results.with_name("optimism-quick.jsonl")
    env = f"swing-up:action_cost={options.action_cost:g}"
    jobs = [
        Job(
            arm=f"{arm}, {reward}",
            env=env,
            seed=seed,
            kind="known" if reward == "known" else "hiprl",
            settings={"config": {"optimism": arm, "comparisons": options.episodes, "kappa": KAPPA, "search": SEARCH}},
        )
        for seed in seeds_of(options.seeds)
        for reward in options.reward
        for arm in options.arms
    ]
    outcomes = run_all(jobs, results=options.results, workers=options.workers)
    best = max(outcome["return_mean"] for _, outcome in outcomes)
    report = Report(f"Swing-up, action cost {options.action_cost:g}, {options.episodes} episodes")
    for (_, arm), group in by_arm(outcomes).items():
        report.add(**row(arm, group, best))
    report.notes.append(f"The best policy of all runs returns {best:.1f}; doing nothing returns 0.")
    report.show()
    report.write(options.json, seeds=seeds_of(options.seeds), env=env)


if __name__ == "__main__":
    main()
