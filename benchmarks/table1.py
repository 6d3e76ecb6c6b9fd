"""The paper's Table 1: what a policy returns after 30 comparisons, over seeds, beside PPO that sees the true reward.

Arms: the presets of hiprl (`default`, `paper`) with a judge that gives the exact difference of two returns, and
Stable-Baselines3's PPO on the true environment and reward with the paper's settings (Tables 2 and 3) and with tuned
ones (RL Baselines3 Zoo). PPO gets --ppo-steps steps of the environment; hiprl about 71,000 at most, 31,000 of them to
learn from, and no reward.

A table shows for each arm the mean return of its policies over ten fresh episodes, its spread over seeds, and the
interquartile mean with a 95 % bootstrap interval. `solved_by`: after how many comparisons the policy that would be
reported got 1000, and every later one too.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from benchmarks.common import Report, parser
from benchmarks.runner import Job, Outcome, add_running, by_arm, run_all, seeds_of, spread

ENVS = ("InvertedPendulum-v5", "HalfCheetah-v5")
ARMS = ("default", "paper", "ppo-paper", "ppo-tuned")
SOLVED = {"InvertedPendulum-v5": 1000.0}
TUNED: dict[str, dict[str, Any]] = {
    "InvertedPendulum-v5": {
        "normalize": True,
        "ppo": {
            "n_steps": 32,
            "batch_size": 64,
            "n_epochs": 5,
            "gamma": 0.999,
            "learning_rate": 0.000222425,
            "ent_coef": 1.37976e-07,
            "clip_range": 0.4,
            "gae_lambda": 0.9,
            "max_grad_norm": 0.3,
            "vf_coef": 0.19816,
        },
    },
    "HalfCheetah-v5": {
        "normalize": True,
        "ppo": {
            "n_steps": 512,
            "batch_size": 64,
            "n_epochs": 20,
            "gamma": 0.98,
            "learning_rate": 2.0633e-05,
            "ent_coef": 0.000401762,
            "clip_range": 0.1,
            "gae_lambda": 0.92,
            "max_grad_norm": 0.8,
            "vf_coef": 0.58096,
        },
        "policy": {
            "log_std_init": -2,
            "ortho_init": False,
            "activation": "relu",
            "net_arch": {"pi": [256, 256], "vf": [256, 256]},
        },
    },
}
"""RL Baselines3 Zoo, hyperparams/ppo.yml, InvertedPendulum-v3 and HalfCheetah-v3; tuned there for 1e6 steps."""


def jobs_of(options: argparse.Namespace) -> list[Job]:
    """All runs of the table, seeds outermost: after each round every arm has one seed more."""
    from hiprl.config import paper

    def job(env: str, arm: str, seed: int) -> Job:
        if not arm.startswith("ppo"):
            config = {"comparisons": options.comparisons, "warm_up": min(5, options.comparisons)}
            return Job(arm=arm, env=env, seed=seed, settings={"preset": arm, "config": config})
        told = {"ppo": asdict(paper(env).search)} if arm == "ppo-paper" else TUNED[env]
        settings = {"steps": options.ppo_steps, "eval_episodes": 10, **told}
        return Job(arm=arm, env=env, seed=seed, kind="sb3", settings=settings)

    return [job(env, arm, seed) for seed in seeds_of(options.seeds) for env in options.envs for arm in options.arms]


def solved_by(env: str, reported: list[float | None]) -> int | None:
    """After how many comparisons the task was solved and stayed so; None if it was not."""
    first = None
    for k, value in enumerate(reported, start=1):
        solved = value is not None and value >= SOLVED[env]
        first = (first or k) if solved else None
    return first


def row(env: str, arm: str, outcomes: list[tuple[Job, Outcome]]) -> dict[str, Any]:
    """One line of the table."""
    found = {"env": env, "arm": arm, **spread([outcome["return_mean"] for _, outcome in outcomes])}
    found["env_steps"] = max(outcome["env_steps"] for _, outcome in outcomes)
    found["wall_s"] = sum(outcome["wall_seconds"] for _, outcome in outcomes) / len(outcomes)
    if env in SOLVED and "reported" in outcomes[0][1]:
        by = [solved_by(env, outcome["reported"]) for _, outcome in outcomes]
        found["solved_by"] = ", ".join("never" if k is None else str(k) for k in by)
    return found


def main() -> None:
    """Runs what is missing and reports."""
    made = parser(__doc__)
    add_running(made, results="runs/benchmarks/table1.jsonl", seeds="0-4")
    made.add_argument("--envs", nargs="+", default=list(ENVS), choices=ENVS, help="environments")
    made.add_argument("--arms", nargs="+", default=list(ARMS), choices=ARMS, help="what is compared")
    made.add_argument("--comparisons", type=int, default=30, help="answers that the judge gives")
    made.add_argument("--ppo-steps", type=int, default=200_000, help="environment steps of PPO; the paper has 1e6")
    options = made.parse_args()
    if options.quick:
        options.seeds, options.comparisons, options.ppo_steps = "0", 6, 2048
        options.envs = ["InvertedPendulum-v5"]
        options.results = options.results.with_name("table1-quick.jsonl")
    outcomes = run_all(jobs_of(options), results=options.results, workers=options.workers)
    report = Report(f"Returns after {options.comparisons} comparisons, and of PPO after {options.ppo_steps:,} steps")
    for (env, arm), group in by_arm(outcomes).items():
        report.add(**row(env, arm, group))
    report.show()
    report.write(options.json, seeds=seeds_of(options.seeds))


if __name__ == "__main__":
    main()
