"""`hiprl export` and `hiprl import`."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np

from hiprl.cli.commands import DEFAULT_STORE, Export, Facts, Import
from hiprl.cli.saying import say
from hiprl.errors import InputError
from hiprl.store.exchange import exported, imported
from hiprl.store.rows import PEOPLE, TrajectoryRow
from hiprl.store.store import open_store


def export(command: Export) -> Facts:
    """Writes a run's answers or trajectories into a file; gives its name and how many there are."""
    path = Path(command.to).expanduser()
    if path.suffix not in (".jsonl", ".npz"):
        raise InputError(
            f"got the file {command.to!r}; its ending says what is taken away: .jsonl the questions and answers, .npz "
            "the trajectories. Write for example --to answers.jsonl."
        )
    with open_store(command.store, create=False) as store:
        run_id, name = store.find_run(command.run).id, store.name
        try:
            if path.suffix == ".npz":
                taus = store.trajectories(run_id)
                np.savez_compressed(path, allow_pickle=False, **arrays(taus))
                n, what = len(taus), "trajectories"
            else:
                lines = list(exported(store, run_id))
                path.write_text("\n".join(lines) + "\n", encoding="utf-8")
                n, what = len(lines) - 1, "questions and answers"
        except OSError as e:
            raise InputError(
                f"cannot write {path}: {e.strerror}. Name a file in a folder that you may write to."
            ) from e
    say(f"{n} {what} of {run_id} are in {path}.")
    return {"run": run_id, "file": str(path), "count": n, "store": name}


def bring(command: Import) -> Facts:
    """Takes the answers of a file into their run; gives how many were new."""
    path = Path(command.file).expanduser()
    try:
        lines = path.read_text(encoding="utf-8-sig").split("\n")  # names may hold other ends of lines
    except (OSError, UnicodeDecodeError) as e:
        why = e.strerror if isinstance(e, OSError) else "it is not text"
        raise InputError(f"cannot read {path}: {why}. Name a file that `hiprl export` wrote.") from e
    with open_store(command.store, create=False) as store:
        try:
            found, name = imported(store, lines), store.name
        except InputError as e:
            raise InputError(f"in {path}, {e}") from e
        judge, finished = store.run(found.run).spec.get("judge"), store.final(found.run) is not None
    is_new = "1 answer is" if found.added == 1 else f"{found.added} answers are"
    are_open = "1 question is" if found.open == 1 else f"{found.open} questions are"
    again = ["hiprl", "relearn", found.run] + ([] if command.store == DEFAULT_STORE else ["--store", name])
    say(
        f"{is_new} new to {found.run}, {found.known} were there already, {are_open} open. "
        f"What a reward makes of them: {shlex.join(again)}"
    )
    if found.changed and not finished and judge != PEOPLE:
        say("The run itself goes on with what its judge said: `hiprl resume` does not take changed answers in.")
    return {**found._asdict(), "store": name}


def arrays(taus: list[TrajectoryRow]) -> dict[str, np.ndarray]:
    """Trajectories in arrays of one length, padded with NaN.

    Raises:
        InputError: there are none.
    """
    if not taus:
        raise InputError(
            "the run has executed nothing yet; at least one trajectory is needed. Let it go on with `hiprl resume RUN`."
        )
    H = max(tau.length for tau in taus)
    padded = lambda x, n: np.pad(x, [(0, n - len(x)), *[(0, 0)] * (x.ndim - 1)], constant_values=np.nan)
    return {
        "states": np.stack([padded(tau.states, H + 1) for tau in taus]),
        "actions": np.stack([padded(tau.actions, H) for tau in taus]),
        "rewards": np.stack([padded(tau.rewards, H) for tau in taus]),
        "lengths": np.array([tau.length for tau in taus]),
        "terminated": np.array([tau.terminated for tau in taus]),
        "imagined": np.array([tau.imagined for tau in taus]),
    }
