from __future__ import annotations

import json

import numpy as np
import pytest

from hiprl.report.record import record
from hiprl.report.summary import recent, summary
from hiprl.store.store import Store
from tests.report.made_up import VERSIONS, add_run, spec

KEYS = [
    *("run", "env", "seed", "judge", "begun", "finished", "comparisons", "planned_comparisons", "env_steps"),
    *(
        "return_mean",
        "return_std",
        "eval_episodes",
        "best_executed_return",
        "coverage",
        "beta",
        "kappa",
        "alpha",
        "worth",
    ),
    *("deviation", "rollout_errors", "preference_deviation", "right_signs", "imagined", "executed", "overpromised"),
    *("seconds", "wall_seconds", "versions", "store", "episodes"),
]


def test_the_numbers_of_a_finished_run(store: Store) -> None:
    run = record(store, store.run(add_run(store, seed=3)))
    facts = summary(run)
    assert [*facts] == KEYS
    assert (facts["comparisons"], facts["planned_comparisons"], facts["finished"]) == (12, 12, True)
    assert (facts["return_mean"], facts["return_std"]) == (3030.0, 7.0)
    assert facts["best_executed_return"] == run.best[-1]
    assert facts["seconds"] == {"propose": 36.0, "judge": 6.0, "learn": 18.0, "practise": 0.0}
    assert facts["wall_seconds"] == 60.0
    assert [*facts["rollout_errors"]] == ["1", "5", "20", "50"]
    assert facts["coverage"] == pytest.approx(np.median(run.series("coverage")[4:]))
    json.dumps(facts, allow_nan=False)


def test_a_run_without_any_episode_has_numbers_too(store: Store) -> None:
    run = record(store, store.run(store.add_run("Hopper-v5", 0, spec(), VERSIONS)))
    facts = summary(run)
    assert [*facts] == KEYS
    assert (facts["comparisons"], facts["finished"], facts["return_mean"], facts["wall_seconds"]) == (0, False, None, 0)
    json.dumps(facts, allow_nan=False)


def test_sides_count_from_the_first_policy_on_and_not_where_none_was_said(store: Store) -> None:
    run_id = store.add_run("Hopper-v5", 0, spec(), VERSIONS)
    for k, (foreseen, searched) in enumerate([(0.0, False), (1.0, True), (0.0, True), (None, True), (1.0, True)], 1):
        store.finish_episode(run_id, k, {"k": k, "foreseen": foreseen, "searched": searched}, b"%d" % k)
    assert summary(record(store, store.run(run_id)))["right_signs"] == pytest.approx(2 / 3)


def test_an_episode_with_many_answers_counts_for_as_many(store: Store) -> None:
    run_id = store.add_run("Hopper-v5", 0, spec(), VERSIONS)
    for k, (foreseen, told) in enumerate([(0.5, 10), (1.0, 1)], 1):
        facts = {"k": k, "foreseen": foreseen, "told": told, "searched": True}
        store.finish_episode(run_id, k, facts, b"%d" % k)
    assert summary(record(store, store.run(run_id)))["right_signs"] == pytest.approx(6 / 11)


def test_recent_is_the_median_of_the_newest_known() -> None:
    assert recent(np.array([100.0] * 5 + [1.0, np.nan] * 10)) == 1.0
    assert recent(np.array([np.nan])) is None
