"""Runs that nobody executed: facts with the shape of real ones, put into a store."""

from __future__ import annotations

from typing import Any

import numpy as np

from hiprl.config import Config
from hiprl.spec import to_plain
from hiprl.store.store import Store

VERSIONS = {"hiprl": "0.1.0", "python": "3.11.2"}
SECONDS = {"propose": 3.0, "judge": 0.5, "learn": 1.5}


def spec(config: Config | None = None, *, env: str | None = "Hopper-v5", judge: str = "exact") -> dict[str, Any]:
    """What a run's row says."""
    return {
        "env": env,
        "horizon": 1000,
        "judge": judge,
        "eval_episodes": 10,
        "terminates": None,
        "config": to_plain(config or Config(comparisons=12)),
    }


def facts(k: int, *, warm_up: int = 5, top: float = 3000.0, draw: np.random.Generator, pays: bool = True) -> dict:
    """Of episode k of a run that gets better; as `session.facts_of` has them."""
    searched = k >= warm_up
    true_return = (
        top * (1 - np.exp(-(k - warm_up + 1) / 5)) * draw.uniform(0.6, 1.05) if searched else draw.normal(0, 9)
    )
    error = 900 * np.exp(-k / 6) * draw.exponential()
    g = float(true_return + draw.normal(0, 50))
    found = {
        "k": k,
        "comparisons": k,
        "env_steps": 1000 * (k + 1),
        "length": 1000,
        "true_return": float(true_return) if pays else None,
        "g": g,
        "foreseen": float(draw.uniform() < 0.9) if k > 1 else None,
        "g_predicted": g - float(error * draw.choice([-1, 1])),
        "sigma_g": float(700 * np.exp(-k / 6)) if k > 1 else 6e-6,
        "alpha": 335469.0 if k < 11 else 2.0 + 3 / k,
        "return_by_reward": float(true_return * 1.1 + 3),
        "searched": searched,
        "seconds": SECONDS,
    }
    if searched:
        imagined = 0.3 * true_return * draw.uniform(0.9, 1.5)
        off = 3 * np.exp(-k / 8) * draw.uniform(0.8, 1.3)
        found |= {
            "imagined": float(imagined),
            "imagined_worst": float(imagined * draw.uniform(0.6, 0.95)),
            "executed": float(0.3 * true_return),
            "overpromised": bool(imagined > 0.4 * true_return),
            "beta": float(draw.uniform(0.5, 2)),
            "kappa": 1.0,
            "deviation": float(5 * np.exp(-k / 8) * draw.uniform(0.8, 1.2)),
            "relative_error": 0.1,
            "coverage": float(draw.uniform(0.7, 0.97)),
            "rollout_errors": {str(h): float(h**0.8 * off) for h in (1, 5, 20, 50)},
            "best_trajectory": k,
            "best_return": float(true_return) if pays else None,
        }
    return found


def add_run(
    store: Store,
    *,
    env: str = "Hopper-v5",
    seed: int = 0,
    config: Config | None = None,
    judge: str = "exact",
    episodes: int | None = None,
    finished: bool = True,
    top: float = 3000.0,
    pays: bool = True,
) -> str:
    """A run in the store, with all its episodes or the first few; gives its id."""
    config = config or Config(comparisons=12)
    run_id = store.add_run(env, seed, spec(config, env=env, judge=judge), VERSIONS)
    draw = np.random.default_rng([3, seed])
    for k in range(1, (config.comparisons if episodes is None else episodes) + 1):
        store.finish_episode(
            run_id, k, facts(k, warm_up=config.warm_up, top=top, draw=draw, pays=pays), b"state %d" % k
        )
    if finished:
        store.finish(run_id, final(run_id, env, seed, config, top=top, pays=pays, where=store.name), b"policy")
    return run_id


def final(run_id: str, env: str, seed: int, config: Config, *, top: float, pays: bool, where: str) -> dict[str, Any]:
    """The summary of a finished run; better with greater seeds."""
    return {
        "run": run_id,
        "env": env,
        "seed": seed,
        "comparisons": config.comparisons,
        "env_steps": 1000 * (config.comparisons + 1),
        "return_mean": top + 10 * seed if pays else None,
        "return_std": 7.0 if pays else None,
        "eval_episodes": 10,
        "wall_seconds": 5.0 * config.comparisons,
        "store": where,
    }
