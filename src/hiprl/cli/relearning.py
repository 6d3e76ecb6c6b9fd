"""`hiprl relearn`."""

from __future__ import annotations

import numpy as np
from rich import box
from rich.table import Table

from hiprl.cli.commands import Facts, Relearn
from hiprl.cli.showing import known, output, percent
from hiprl.errors import InputError
from hiprl.models.quality import shapes
from hiprl.models.reward import AdditiveConfig
from hiprl.report.evidence import as_said, evidence_of, quality, relearned
from hiprl.store.store import open_store

LINEAR = (1e-6,)
"""Candidates for the share of the smooth part where there is to be none."""
MOST = 5  # entries of state and action that are named


def relearn(command: Relearn) -> Facts:
    """Learns the reward again, prints how good it is, and gives the same as plain values."""
    if command.folds < 2:
        raise InputError(
            f"got {command.folds} folds; at least 2 are needed, to predict each from the others. Say `--folds 10`."
        )
    with open_store(command.store, create=False) as store:
        row = store.find_run(command.run)
        T, P = evidence_of(store, row)
    config = AdditiveConfig() if command.features == "smooth" else AdditiveConfig(smooth=LINEAR)
    P = as_said(P, command.answers)
    reward = relearned(T, P, config)
    returns = np.asarray(reward.returns(T))
    weights = np.asarray(shapes(reward, T).weight)
    p = T.rows.states.shape[2]
    names = [f"s[{j}]" for j in range(p)] + [f"a[{j}]" for j in range(len(weights) - p)]
    most = np.argsort(-weights)[:MOST]
    total = float(weights.sum()) or 1.0
    facts: Facts = {
        "run": row.id,
        "features": command.features,
        "answers_used": command.answers,
        **quality(T, P, config, folds=command.folds),
        "best_trajectory": int(np.argmax(returns)),
        "weights": {names[j]: float(weights[j]) / total for j in most},
        "store": command.store,
    }
    table = Table("reward learned again", row.id, box=box.SIMPLE_HEAD)
    for name, words in {
        "answers": f"{facts['answers']}, {'all that was said' if command.answers == 'all' else 'as choices'}",
        "features": command.features,
        "kept answers, right side": percent(facts["held_out_accuracy"]),
        "kept answers, log likelihood": f"{known(facts['held_out_log_likelihood'])} nats an answer",
        "kept numbers in their 90 % interval": percent(facts["coverage_90"]),
        "same question, same side": percent(facts["consistency"]),
        "best trajectory": str(facts["best_trajectory"]),
        "goes by": ", ".join(f"{name} {percent(share)}" for name, share in facts["weights"].items()),
    }.items():
        table.add_row(name, words)
    output(command.json).print(table)
    return facts
