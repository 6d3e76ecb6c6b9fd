from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from hiprl.config import Config, preset
from hiprl.control.ppo import PPOConfig
from hiprl.report.arm_figure import comparison
from hiprl.report.arms import arms_of, compared
from hiprl.report.record import Record, record
from hiprl.store.rows import CUSTOM, PEOPLE
from hiprl.store.store import Store
from tests.report.made_up import add_run

BASE = Config(comparisons=12)
KEYS = [
    *("arm", "env", "runs", "seeds", "finished", "return_iqm", "return_low", "return_high", "return_min"),
    *("return_max", "reach", "reached", "comparisons_needed", "wall_seconds"),
]


def all_of(store: Store) -> list[Record]:
    return [record(store, row) for row in store.runs()]


def test_runs_that_differ_in_their_seed_alone_are_one_arm(store: Store) -> None:
    for seed in (5, 7, 11):
        add_run(store, seed=seed)
        add_run(store, seed=seed, config=replace(BASE, optimism="greedy"))
    add_run(store, seed=5, judge="noisy:3")
    arms = arms_of([*all_of(store), *all_of(store)])  # named twice, counted once
    assert [arm.name for arm in arms] == ["default", "optimism greedy", "judge noisy:3"]
    assert [[run.row.seed for run in arm.runs] for arm in arms] == [[5, 7, 11], [5, 7, 11], [5]]


def test_one_seed_of_a_script_counts_once_and_each_run_of_people(store: Store) -> None:
    first, second = (add_run(store, seed=5) for _ in range(2))
    unfinished = add_run(store, seed=5, finished=False)
    for _ in range(2):
        add_run(store, seed=5, judge=PEOPLE)
    scripted, people = arms_of(all_of(store))
    assert [run.id for run in scripted.runs] == [second] and len(people.runs) == 2
    assert first != second != unfinished


def test_runs_of_two_versions_are_two_arms(store: Store) -> None:
    old = add_run(store, seed=5)
    row = store.run(old)
    new = store.add_run(row.env, 5, row.spec, {**row.versions, "hiprl": "9.9"})
    arms = arms_of(all_of(store))
    assert [[run.id for run in arm.runs] for arm in arms] == [[old], [new]]
    assert arms[1].name == "hiprl 9.9"


def test_runs_from_before_functions_had_names_are_no_arm_of_their_own(store: Store) -> None:
    row = store.run(add_run(store, seed=5))
    assert "function" not in row.spec
    store.add_run(row.env, 7, {**row.spec, "function": None}, row.versions)
    assert [[run.row.seed for run in arm.runs] for arm in arms_of(all_of(store))] == [[5, 7]]


def test_two_functions_that_judge_are_two_arms(store: Store) -> None:
    for name in ("mine.first", "mine.second"):
        plain = store.run(add_run(store, judge=CUSTOM, finished=False)).spec
        store.add_run("Hopper-v5", 7, {**plain, "function": name}, {"hiprl": "0.1"})
    names = [arm.name for arm in arms_of(all_of(store))]
    assert [name for name in names if "mine" in name] == ["judge mine.first, hiprl 0.1", "judge mine.second, hiprl 0.1"]


def test_what_was_to_be_learned_sets_arms_apart(store: Store) -> None:
    for goal in ("run forwards", "run backwards", "run forwards"):
        store.set_goal(add_run(store, judge=PEOPLE), goal)
    arms = arms_of(all_of(store))
    assert [(arm.name, len(arm.runs)) for arm in arms] == [('"run forwards"', 2), ('"run backwards"', 1)]


def test_a_curve_is_over_runs_that_had_as_many_answers(store: Store) -> None:
    for seed, (answers, best) in enumerate([((4, 10, 20), (1, 2, 3)), ((4, 4, 6, 20), (10, 20, 30, 40))]):
        run_id = add_run(store, seed=seed, judge=PEOPLE, episodes=0)
        for k, (comparisons, reached) in enumerate(zip(answers, best, strict=True), 1):
            facts = {"k": k, "comparisons": comparisons, "best_return": float(reached), "searched": True}
            store.finish_episode(run_id, k, facts, b"%d" % k)
    (arm,) = arms_of(all_of(store))
    k, points = arm.curve()
    assert k.tolist() == [4, 6, 10, 20]
    assert [point.mean for point in points] == [(1 + 20) / 2, (1 + 30) / 2, (2 + 30) / 2, (3 + 40) / 2]


def test_names_say_what_differs(store: Store) -> None:
    kappa = {"kappa": 0.3}
    add_run(store, config=replace(BASE, **kappa))
    add_run(store, config=replace(BASE, **kappa, optimism="bonus"))
    add_run(store, config=replace(BASE, **kappa, search=PPOConfig()))
    add_run(store, config=replace(BASE, **kappa, search=PPOConfig(n_epochs=3)))
    assert [arm.name for arm in arms_of(all_of(store))] == ["default", "optimism bonus", "search ppo", "search ppo (2)"]


def test_presets_and_lengths_are_named_where_they_differ(store: Store) -> None:
    add_run(store)
    add_run(store, config=replace(preset("paper", "Hopper-v5"), comparisons=17))
    assert [arm.name for arm in arms_of(all_of(store))] == ["default, 12 comparisons", "paper, 17 comparisons"]


def test_environments_are_apart(store: Store) -> None:
    add_run(store, env="Hopper-v5")
    add_run(store, env="Walker2d-v5", top=900.0)
    first, second = compared(arms_of(all_of(store)))
    assert (first["arm"], first["env"], second["arm"], second["env"]) == (
        *("default", "Hopper-v5"),
        *("default", "Walker2d-v5"),
    )
    assert first["reach"] > 2 * second["reach"]


def test_the_numbers_of_an_arm(store: Store) -> None:
    for seed in range(1, 9):  # returns 3010, 3020, ..., 3080
        add_run(store, seed=seed)
    (line,) = compared(arms_of(all_of(store)))
    assert [*line] == KEYS
    assert line["return_iqm"] == pytest.approx(np.mean([3030, 3040, 3050, 3060]))
    assert line["return_min"] <= line["return_low"] < line["return_iqm"] < line["return_high"] <= line["return_max"]
    json.dumps(line, allow_nan=False)


def test_comparisons_needed_to_reach_a_return(store: Store) -> None:
    for seed in range(3):
        add_run(store, seed=seed)
    runs = all_of(store)
    (line,) = compared(arms_of(runs), reach=1500.0)
    first = [int(np.flatnonzero(run.best >= 1500.0)[0]) + 1 for run in runs]
    assert (line["reached"], line["comparisons_needed"]) == (3, np.median(first))
    (line,) = compared(arms_of(runs), reach=1e6)
    assert (line["reached"], line["comparisons_needed"]) == (0, None)


def test_a_run_that_is_not_finished_counts_only_alone(store: Store) -> None:
    add_run(store, episodes=7, finished=False)
    (line,) = compared(arms_of(all_of(store)))
    assert (line["finished"], line["return_iqm"], line["reach"]) == (0, None, None)
    (arm,) = arms_of(all_of(store))
    assert arm.curve()[0].tolist() == [5.0, 6.0, 7.0]
    add_run(store, seed=1)
    (arm,) = arms_of(all_of(store))
    (line,) = compared([arm])
    assert (line["finished"], line["return_iqm"], line["return_low"]) == (1, 3010.0, None)
    assert arm.curve()[0].tolist() == list(range(5, 13))


def test_the_curve_is_the_middle_of_the_runs(store: Store) -> None:
    for seed in range(4):
        add_run(store, seed=seed)
    runs = all_of(store)
    k, curve = arms_of(runs)[0].curve()
    for i, point in zip(k.astype(int), curve, strict=True):
        column = sorted(run.best[i - 1] for run in runs)
        assert point.mean == pytest.approx(np.mean(column[1:3]))
        assert column[0] <= point.low <= point.mean <= point.high <= column[-1]


def test_the_picture_has_a_panel_an_environment_and_a_line_an_arm(store: Store) -> None:
    for seed in range(2):
        add_run(store, seed=seed)
        add_run(store, seed=seed, config=replace(BASE, optimism="greedy"))
    add_run(store, env="Mine-v0", pays=False)
    figure = comparison(arms_of(all_of(store)))
    hopper, mine = figure.axes
    assert hopper.get_title(loc="left") == "Hopper-v5"
    named = [text.get_text() for text in hopper.get_legend().get_texts()]
    assert [name.split("\xa0")[0] for name in named] == ["default (n", "optimism greedy (n", "reported policy"]
    assert "pays none" in mine.texts[0].get_text()
