"""Kill -9 at random moments, resume, and compare with a run that was left alone: all must be equal, bit for bit.

One run is left alone. Others with the same seed are killed at random moments and resumed, again and again, until they
end; when enough kills have happened, the last one is let through. After each kill the store must open and hold every
answer that it held before. At the end the summary, the facts of all episodes (but times), all trajectories, all
answers and the learned policy must be those of the run that was left alone.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import Report, add_core, one_core, parser, progress

SHARE = 3  # a run is killed after at most this part of the time that it needs: so several times before its end
LONGER = 1.5  # times as long as that, for each time that it was killed before it had done one more episode
OWN = ("run", "store", "wall_seconds")  # of a summary: what differs between two runs


def command(options: argparse.Namespace, store: Path) -> list[str]:
    """What starts the run, or goes on with it."""
    run = run_in(store)
    hiprl = [sys.executable, "-m", "hiprl"]
    if run is not None:
        return [*hiprl, "resume", run, "--store", str(store)]
    settings = {"comparisons": options.comparisons, "seed": options.seed, "preset": options.preset, "store": store}
    flags = [part for name, value in settings.items() for part in (f"--{name}", str(value))]
    return [*hiprl, "train", options.env, *flags]


def run_in(store: Path) -> str | None:
    """The id of the run, if it has got that far."""
    from hiprl.errors import InputError
    from hiprl.store.store import open_store

    if not store.exists():
        return None
    try:
        with open_store(store, create=False) as opened:
            runs = opened.runs()
    except InputError:  # killed while the store was made
        return None
    return runs[0].id if runs else None


def facts(store: Path) -> dict[str, Any]:
    """All that must be equal."""
    from hiprl.store.store import open_store

    with open_store(store, create=False) as opened:
        run = opened.runs()[0].id
        episodes = [{name: x for name, x in told.items() if name != "seconds"} for _, told in opened.episodes(run)]
        summary = opened.final(run) or {}
        return {
            "summary": {name: x for name, x in summary.items() if name not in OWN},
            "episodes": episodes,
            "answers": [(answer.k, answer.g) for answer in opened.answers(run)],
            "trajectories": [row.values() for row in opened.trajectories(run)],
            "policy": opened.policy(run),
        }


def answers(store: Path) -> list[tuple[int, float]]:
    """The answers that the store holds."""
    return facts(store)["answers"] if run_in(store) is not None else []


def finished(store: Path) -> bool:
    """Whether nothing of the run is left to do."""
    from hiprl.store.store import open_store

    run = run_in(store)
    if run is None:
        return False
    with open_store(store, create=False) as opened:
        return opened.final(run) is not None


def let_through(line: Sequence[str]) -> float:
    """Seconds of a run that nobody kills."""
    began = time.perf_counter()
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(line)} failed:\n{done.stderr[-2000:]}")
    return time.perf_counter() - began


def killed(line: Sequence[str], after: float) -> bool:
    """Whether the run was still going after so many seconds; then it is dead now."""
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        _, said = process.communicate(timeout=after)
    except subprocess.TimeoutExpired:
        return True
    finally:
        process.kill()
        process.wait()
    if process.returncode:
        raise SystemExit(f"{' '.join(line)} failed:\n{said[-2000:]}")
    return False


def main() -> None:
    """Kills, compares and reports."""
    made = parser(__doc__)
    made.add_argument("--env", default="InvertedPendulum-v5", help="environment")
    made.add_argument("--comparisons", type=int, default=8, help="answers of a run")
    made.add_argument("--preset", default="default", help="settings")
    made.add_argument("--seed", type=int, default=0, help="of the runs")
    made.add_argument("--kills", type=int, default=20, help="how often a run is killed")
    made.add_argument("--moments", type=int, default=0, help="seed of the moments")
    add_core(made)
    options = made.parse_args()
    if options.quick:
        options.comparisons, options.kills = 4, 3
    one_core(options.core)
    report = Report(f"{options.kills} kills at random moments: {options.env}, {options.comparisons} comparisons")
    with tempfile.TemporaryDirectory() as name:
        wrong = measure(options, Path(name), report)
    report.notes.append(
        f"{len(report.rows)} kills; " + (f"NOT EQUAL: {', '.join(wrong)}" if wrong else "all runs equal, bit for bit")
    )
    report.show()
    report.write(options.json, seed=options.seed, moments=options.moments, equal=not wrong)
    sys.exit(1 if wrong else 0)


def measure(options: argparse.Namespace, folder: Path, report: Report) -> list[str]:
    """What was not equal in which run."""
    moments = random.Random(options.moments)
    alone = folder / "alone.db"
    let_through(command(options, folder / "first.db"))  # fills the cache of compiled programs
    took = let_through(command(options, alone))
    progress(f"The run that is left alone took {took:.1f} s")
    expected, wrong, number = facts(alone), [], 0
    while len(report.rows) < options.kills:
        number += 1
        store, held, going, before, stuck = folder / f"killed-{number}.db", [], True, 0, 0
        while going and len(report.rows) < options.kills:
            after = moments.uniform(0, took / SHARE * LONGER**stuck)
            going = killed(command(options, store), after)
            if not going:
                break
            now = answers(store)
            if now[: len(held)] != held:
                wrong.append(f"run {number} lost an answer")
            held = now
            done = len(facts(store)["episodes"]) if run_in(store) is not None else 0
            before, stuck = done, stuck + 1 if done == before else 0
            report.add(kill=len(report.rows) + 1, run=number, after_s=after, episodes_done=done, answers=len(now))
            progress(f"kill {len(report.rows)}: run {number} after {after:.1f} s, with {done} episodes done")
            going = not finished(store)  # it may have been killed on its way out
        if going:
            let_through(command(options, store))
        found = facts(store)
        wrong += [f"run {number}: {part}" for part in expected if found[part] != expected[part]]
    return wrong


if __name__ == "__main__":
    main()
