"""Many runs, each in a process of its own on a core of its own; results are added to a file as they come.

A run that is already in the file is not done again, and one that was stopped goes on with its last episode.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.common import cores, machine, progress

if TYPE_CHECKING:
    from hiprl.config import Config

Outcome = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Job:
    """One run."""

    arm: str
    """What is compared: the table has one row an arm and environment."""
    env: str
    seed: int
    kind: str = "hiprl"
    """`hiprl`; `known` for a run that knows the reward; or `sb3`: Stable-Baselines3's PPO in the true environment."""
    settings: dict[str, Any] = field(default_factory=dict)
    """hiprl: `preset`, `comparisons`, `judge`, `horizon`, and in `config` what differs from the preset, its parts as
    `hiprl.spec.to_plain` has them. sb3: as `sb3_side.py` has it."""

    @property
    def name(self) -> str:
        """Tells it from the others, and names its files."""
        parts = f"{self.env}.{self.arm}.{self.seed}"
        return "".join(c if c.isalnum() or c in "-_." else "-" for c in parts)


def add_running(made: argparse.ArgumentParser, *, results: str, seeds: str) -> None:
    """The flags that all programs with many runs have."""
    made.add_argument("--seeds", default=seeds, metavar="A-B", help="seeds of the runs, as 0-9 or 3,5,7")
    made.add_argument("--results", type=Path, default=Path(results), help="where results are added, one JSON a line")
    made.add_argument("--workers", type=int, default=len(cores()), help="runs at a time, each on one core")


def seeds_of(text: str) -> list[int]:
    """0-2,7 as [0, 1, 2, 7]."""
    found = []
    for part in text.split(","):
        low, _, high = part.partition("-")
        found += range(int(low), int(high or low) + 1)
    return found


def run_all(jobs: Sequence[Job], *, results: Path, workers: int) -> list[tuple[Job, Outcome]]:
    """The outcome of each job, in the order given: from the file, or from a run now."""
    results.parent.mkdir(parents=True, exist_ok=True)
    done = known(results, jobs)
    waiting = [job for job in jobs if job.name not in done]
    if done:
        progress(f"{len(done)} of {len(jobs)} runs are in {results} already")
    free, running, failed = cores(), {}, []
    free = [free[i % len(free)] for i in range(max(1, workers))]
    try:
        while waiting or running:
            while waiting and free:
                job, core = waiting.pop(0), free.pop(0)
                running[begin(job, core, results)] = (job, core, time.perf_counter())
            time.sleep(0.2)
            for process in [process for process in running if process.poll() is not None]:
                job, core, began = running.pop(process)
                free.append(core)
                if process.returncode:
                    failed.append(job)
                    progress(f"failed: {job.name}; see {log_of(job, results)}")
                    continue
                outcome = json.loads(outcome_of(job, results).read_text())
                done[job.name] = outcome
                write(results, job, outcome)
                said = f"{outcome['return_mean']:.1f} ± {outcome['return_std']:.1f}"
                left = len(waiting) + len(running)
                progress(f"{job.name}: {said} in {time.perf_counter() - began:.0f} s; {left} runs left")
    finally:
        for process in running:
            process.terminate()
    if failed:
        raise SystemExit(f"{len(failed)} runs failed; the others are in {results}. Start the same again to go on.")
    return [(job, done[job.name]) for job in jobs]


def known(results: Path, jobs: Sequence[Job]) -> dict[str, Outcome]:
    """The outcomes that the file has of these jobs."""
    wanted, found = {job.name: job for job in jobs}, {}
    for line in results.read_text().splitlines() if results.exists() else []:
        row = json.loads(line)
        job = Job(**row["job"])
        if job.name not in wanted:
            continue
        if job != Job(**json.loads(json.dumps(asdict(wanted[job.name])))):
            raise SystemExit(f"{results} has {job.name} with other settings; give another file as --results")
        found[job.name] = row["outcome"]
    return found


def write(results: Path, job: Job, outcome: Outcome) -> None:
    """Adds one line."""
    line = json.dumps({"job": asdict(job), "outcome": outcome, "machine": machine()})
    with results.open("a") as file:
        file.write(line + "\n")
        file.flush()
        os.fsync(file.fileno())


def begin(job: Job, core: int, results: Path) -> subprocess.Popen:
    """Starts a run in a process of its own."""
    folder(results).mkdir(parents=True, exist_ok=True)
    order = json.dumps({"job": asdict(job), "core": core, "store": str(folder(results) / f"{job.name}.db")})
    with log_of(job, results).open("a") as log, outcome_of(job, results).open("w") as outcome:
        return subprocess.Popen([sys.executable, "-m", "benchmarks.runner", order], stdout=outcome, stderr=log)


def folder(results: Path) -> Path:
    """Where the stores and logs of the runs lie."""
    return results.with_suffix("")


def log_of(job: Job, results: Path) -> Path:
    """What a run says."""
    return folder(results) / f"{job.name}.log"


def outcome_of(job: Job, results: Path) -> Path:
    """What a run came to; a file, as a pipe would hold so much of it and no more."""
    return folder(results) / f"{job.name}.json"


# In the process of one run


def work(order: str) -> None:
    """Does one run and prints its outcome."""
    from benchmarks.common import one_core
    from hiprl.cli.machine import prepare

    told = json.loads(order)
    one_core(told["core"])
    prepare()
    job = Job(**told["job"])
    kinds: dict[str, Callable[[], Outcome]] = {
        "hiprl": lambda: by_hiprl(job, Path(told["store"])),
        "known": lambda: by_known(job),
        "sb3": lambda: by_sb3(job),
    }
    print(json.dumps(kinds[job.kind]()))


def config_of(job: Job) -> Config:
    """The settings of a run of ours."""
    from dataclasses import replace

    from hiprl.config import preset
    from hiprl.spec import from_plain

    differs = {name: from_plain(value) for name, value in job.settings.get("config", {}).items()}
    return replace(preset(job.settings.get("preset", "default"), job.env), **differs)


def by_hiprl(job: Job, path: Path) -> Outcome:
    """A run of ours, from its start or from where it was stopped."""
    from hiprl.api import learn, resume
    from hiprl.store.store import open_store

    def watch(facts: Outcome) -> None:
        progress(f"{facts['k']} comparisons: executed {facts['true_return']:.1f}")

    settings = {name: value for name, value in job.settings.items() if name not in ("preset", "config")}
    config = config_of(job)
    with open_store(path) as store:
        runs = store.runs()
        finished = bool(runs) and store.final(runs[0].id) is not None
    if not runs:
        learn(job.env, seed=job.seed, config=config, store=path, watch=watch, **settings)
    elif not finished:
        resume(runs[0].id, settings.get("judge"), store=path, watch=watch)
    with open_store(path) as store:
        run = store.runs()[0].id
        summary, episodes = store.final(run), [facts for _, facts in store.episodes(run)]
    assert summary is not None
    return {**summary, "reported": reported(episodes), "episodes": episodes}


def reported(episodes: Sequence[Outcome]) -> list[float | None]:
    """After each comparison, the executed return of the policy that would then be reported; None in the warm-up."""
    return [facts.get("best_return") for facts in episodes]


def by_known(job: Job) -> Outcome:
    """A run that knows the reward, from its start: it takes minutes."""
    from benchmarks.known import learned

    return learned(job.env, config_of(job), seed=job.seed)


def by_sb3(job: Job) -> Outcome:
    """A run of Stable-Baselines3's PPO in the true environment."""
    import tempfile

    from benchmarks.sb3 import sb3_python

    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump({"env": job.env, "seed": job.seed, **job.settings}, file)
        file.flush()
        side = Path(__file__).with_name("sb3_side.py")
        done = subprocess.run([sb3_python(), side, "world", file.name], stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


# What tables say of many runs


def by_arm(outcomes: Sequence[tuple[Job, Outcome]]) -> dict[tuple[str, str], list[tuple[Job, Outcome]]]:
    """The outcomes of each environment and arm, in the order of the jobs."""
    groups: dict[tuple[str, str], list[tuple[Job, Outcome]]] = {}
    for job, outcome in outcomes:
        groups.setdefault((job.env, job.arm), []).append((job, outcome))
    return groups


def spread(returns: Sequence[float]) -> Outcome:
    """Mean, standard deviation, extremes, and the interquartile mean with its interval."""
    import numpy as np

    from hiprl.evaluate import interval

    x, middle = np.asarray(returns, float), interval(returns)
    return {
        "seeds": len(x),
        "mean": float(x.mean()),
        "std": float(x.std(ddof=1)) if len(x) > 1 else 0.0,
        "min": float(x.min()),
        "max": float(x.max()),
        "iqm": middle.mean,
        "low": middle.low,
        "high": middle.high,
    }


if __name__ == "__main__":
    work(sys.argv[1])
