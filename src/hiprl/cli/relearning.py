"""`hiprl relearn`."""

from __future__ import annotations

from rich import box
from rich.table import Table

from hiprl.cli.commands import Facts, Relearn
from hiprl.cli.showing import output, words_of
from hiprl.errors import InputError
from hiprl.models.reward import AdditiveConfig
from hiprl.report.evidence import as_said, evidence_of, quality, told
from hiprl.store.store import open_store

LINEAR = (1e-6,)
"""Candidates for the share of the smooth part where there is to be none."""


def relearn(command: Relearn) -> Facts:
    """Learns the reward again, prints how good it is, and gives the same as plain values."""
    if command.folds < 2:
        raise InputError(
            f"got {command.folds} folds; at least 2 are needed, to predict each from the others. Say `--folds 10`."
        )
    with open_store(command.store, create=False) as store:
        row = store.find_run(command.run)
        (T, P), name = evidence_of(store, row), store.name
    config = AdditiveConfig() if command.features == "smooth" else AdditiveConfig(smooth=LINEAR)
    P = as_said(P, command.answers)
    found = told(row, T, P, config)
    facts: Facts = {
        "run": row.id,
        "features": command.features,
        "answers_used": command.answers,
        **quality(T, P, config, folds=command.folds),
        "best_trajectory": found.best,
        "weights": found.weights,
        "store": name,
    }
    table = Table("reward learned again", row.id, box=box.SIMPLE_HEAD)
    for name, words in {
        "answers": f"{facts['answers']}, {'all that was said' if command.answers == 'all' else 'as choices'}",
        "features": command.features,
        **words_of(facts),
        "best trajectory": str(facts["best_trajectory"]),
    }.items():
        table.add_row(name, words)
    output(command.json).print(table)
    return facts
