from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from hiprl.config import Config
from hiprl.errors import HiprlError
from hiprl.report.figures import PICTURES, headline, learning, overview, pictures
from hiprl.report.figures import draw as draw_panel
from hiprl.report.record import Record, record
from hiprl.report.style import new_figure, save
from hiprl.store.store import Store
from tests.report.made_up import VERSIONS, add_run, facts, spec

PNG = b"\x89PNG\r\n"


def made(store: Store, **more) -> Record:
    return record(store, store.run(add_run(store, **more)))


def drawn(panel, run: Record):
    _, axes = new_figure(1, 1, width=4.0, height=3.0)
    panel(axes[0, 0], run)
    return axes[0, 0]


@pytest.mark.slow
def test_each_kind_of_run_has_all_its_pictures(store: Store, tmp_path: Path) -> None:
    runs = [
        made(store),
        made(store, pays=False),
        made(store, episodes=2, finished=False),
        made(store, episodes=0, finished=False),
        made(store, config=Config(comparisons=40), episodes=9, finished=False),
    ]
    for run in runs:
        paths = save(pictures(run), tmp_path / run.id)
        assert [path.stem for path in paths] == ["overview", *PICTURES]
        assert all(path.read_bytes().startswith(PNG) for path in paths)


def test_the_learning_curve_shows_the_facts(store: Store) -> None:
    run = made(store)
    axes = drawn(learning, run)
    random, policy, best = axes.lines[:3]
    assert np.array_equal(random.get_ydata(), run.executed[:4])
    assert np.array_equal(policy.get_ydata(), run.executed[4:])
    assert np.array_equal(best.get_ydata(), run.best, equal_nan=True)
    assert axes.get_xlabel() == "comparisons"


def test_without_a_true_return_the_learned_one_is_shown(store: Store) -> None:
    axes = drawn(learning, made(store, pays=False))
    assert "\\hat r" in axes.get_ylabel()
    assert len(axes.lines) == 2


def test_all_axes_have_names(store: Store) -> None:
    for figure in pictures(made(store)).values():
        for axes in figure.axes:
            assert axes.get_xlabel()
            assert axes.get_ylabel()
            assert axes.get_title(loc="left")


def test_facts_that_are_not_known_break_no_picture(store: Store) -> None:
    run_id = store.add_run("Hopper-v5", 0, spec(), VERSIONS)
    for k in range(1, 4):
        facts = {"k": k, "comparisons": k, "searched": k > 1, "true_return": None, "rollout_errors": {"1": None}}
        store.finish_episode(run_id, k, facts, b"%d" % k)
    overview(record(store, store.run(run_id))).draw_without_rendering()


def test_no_picture_touches_the_state_of_pyplot(store: Store) -> None:
    pictures(made(store))
    assert "matplotlib.pyplot" not in sys.modules


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(HiprlError, match=r"cannot write the pictures into .*needed.*--out"):
        save({"one": Figure()}, tmp_path / "file" / "folder")


def test_a_taught_run_counts_its_answers_and_not_its_episodes(store: Store) -> None:
    run_id, draw = store.add_run("Hopper-v5", 0, spec(), VERSIONS), np.random.default_rng(3)
    for k, answered in enumerate([0, 0, 1, 1, 4], 1):  # episodes go on whether people answer or not
        told = facts(k, warm_up=3, draw=draw) | {"comparisons": answered}
        store.finish_episode(run_id, k, told, b"%d" % k)
    run = record(store, store.run(run_id))
    assert run.answered == 4 and headline(run).endswith("4 comparisons")
    _, axes = new_figure(1, 1, width=4.0, height=3.0)
    draw_panel(learning, axes[0, 0], run)
    assert axes[0, 0].get_xlim()[0] < 0
    warm_up = axes[0, 0].patches[0]
    assert warm_up.get_x() + warm_up.get_width() == pytest.approx(0.5)  # its random episodes came before all answers
    store.finish(run_id, {"comparisons": 12, "return_mean": None}, b"policy")
    assert record(store, store.run(run_id)).answered == 12  # the last ones came after the last episode
