from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiprl.errors import InputError
from hiprl.report.record import beside, newest, record
from hiprl.store.store import Store
from tests.report.made_up import SECONDS, VERSIONS, add_run, spec


def test_series_are_the_facts_with_nan_where_nothing_is_known(store: Store) -> None:
    run = record(store, store.run(add_run(store)))
    assert run.k.tolist() == list(range(1, 13))
    assert run.searched.tolist() == [False] * 4 + [True] * 8
    assert run.executed.tolist() == [facts["true_return"] for facts in run.episodes]
    assert np.isnan(run.series("coverage")).tolist() == [True] * 4 + [False] * 8
    assert np.isnan(run.series("no such fact")).all()
    assert run.series("learn", within="seconds").tolist() == [SECONDS["learn"]] * 12
    assert run.series("5", within="rollout_errors")[-1] == run.episodes[-1]["rollout_errors"]["5"]


def test_best_is_the_return_of_the_trajectory_that_was_ranked_first(store: Store) -> None:
    run_id = store.add_run("Hopper-v5", 0, spec(), VERSIONS)
    told = [
        {"k": 1, "true_return": 7.0, "searched": False},
        {"k": 2, "true_return": 11.0, "searched": True, "best_return": 11.0},
        {"k": 3, "true_return": 5.0, "searched": True, "best_return": 11.0},
        {"k": 4, "true_return": 13.0, "searched": True, "best_return": 13.0},
    ]
    for facts in told:
        store.finish_episode(run_id, facts["k"], facts, b"%d" % facts["k"])
    best = record(store, store.run(run_id)).best
    assert np.isnan(best[0])
    assert best[1:].tolist() == [11.0, 11.0, 13.0]


def test_surprise_is_the_error_in_units_of_sigma(store: Store) -> None:
    run = record(store, store.run(add_run(store)))
    last = run.episodes[-1]
    assert run.surprise[-1] == pytest.approx(abs(last["g"] - last["g_predicted"]) / last["sigma_g"])


def test_an_environment_that_pays_nothing_is_noticed(store: Store) -> None:
    assert record(store, store.run(add_run(store))).pays
    assert not record(store, store.run(add_run(store, pays=False))).pays


def test_newest_is_the_run_that_was_begun_last(store: Store) -> None:
    with pytest.raises(InputError, match=r"no run in .*runs.db yet; one is needed.*hiprl train"):
        newest(store)
    add_run(store, seed=3)
    second = add_run(store, seed=2)
    assert newest(store).id == second


def test_pictures_lie_beside_the_store() -> None:
    assert beside("some/where/runs.db", "x") == Path("some/where/x")
    assert beside("runs.db", "x") == Path("x")
    assert beside("postgresql+psycopg://me@host/runs", "x") == Path("runs/x")
