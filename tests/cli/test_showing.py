from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hiprl.cli.commands import Compare
from hiprl.cli.main import main
from hiprl.cli.showing import compare, words_of
from hiprl.config import Config
from hiprl.report.figures import PICTURES
from hiprl.store.store import open_store
from tests.report.made_up import add_run
from tests.report.test_arms import KEYS as ARM_KEYS
from tests.report.test_summary import KEYS as RUN_KEYS

GREEDY = replace(Config(comparisons=12), optimism="greedy")


@pytest.fixture
def where(tmp_path: Path) -> str:
    """A store with two arms of two runs, one of them without an end."""
    path = tmp_path / "runs.db"
    with open_store(path) as store:
        add_run(store, seed=0)
        add_run(store, seed=1)
        add_run(store, seed=0, config=GREEDY)
        add_run(store, seed=1, config=GREEDY, episodes=7, finished=False)
    return str(path)


def ids(where: str) -> list[str]:
    with open_store(where) as store:
        return [row.id for row in store.runs()]


def test_compare_names_what_it_leaves_out(where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_store(where) as store:
        again = add_run(store, seed=0)
    first = ids(where)[0]
    assert main(["compare", "--all", "--store", where, "--out", str(tmp_path), "--json"]) == 0
    shown = capsys.readouterr()
    assert f"Left out, as another run has the same settings and seed: {first}." in shown.err
    assert again in json.loads(shown.out)["arms"][0]["runs"]


@pytest.mark.slow
def test_show_takes_the_newest_run_and_lists_all(where: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "--store", where]) == 0
    shown = capsys.readouterr()
    newest = ids(where)[-1]
    assert all(run_id in shown.out for run_id in ids(where))
    assert "7 of 12, by judge exact" in shown.out
    assert "not finished" in shown.out
    assert "optimism greedy" in shown.out
    folder = Path(where).parent / newest
    assert sorted(path.stem for path in folder.iterdir()) == sorted(["overview", *PICTURES])
    assert f"Pictures: {folder / 'overview.png'}" in shown.err


@pytest.mark.slow
def test_show_with_json(where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = ids(where)[0]
    assert main(["show", first, "--store", where, "--out", str(tmp_path / "here"), "--json"]) == 0
    shown = capsys.readouterr()
    facts = json.loads(shown.out)
    assert [*facts] == [*RUN_KEYS, "pictures"]
    assert (facts["run"], facts["return_mean"]) == (first, 3000.0)
    assert facts["pictures"] == [str(tmp_path / "here" / f"{name}.png") for name in ("overview", *PICTURES)]
    assert "3000.0 ± 7.0 over 10 episodes" in shown.err
    assert ids(where)[1] not in shown.err  # a run that is named is shown alone


@pytest.mark.slow
def test_compare_with_json(where: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "--all", "--store", where, "--json"]) == 0
    shown = capsys.readouterr()
    facts = json.loads(shown.out)
    assert [*facts] == ["arms", "unfinished", "stores", "pictures"]
    assert all([*line] == ARM_KEYS for line in facts["arms"])
    assert [line["arm"] for line in facts["arms"]] == ["default", "optimism greedy"]
    assert facts["unfinished"] == [ids(where)[-1]]
    assert facts["pictures"] == [str(Path(where).parent / "comparison" / "comparison.png")]
    assert "Not finished, so without a final return" in shown.err
    assert "3000 to 3010" in shown.err


def test_compare_finds_runs_in_several_stores(where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = str(tmp_path / "other.db")
    with open_store(other) as store:
        there = add_run(store, env="Walker2d-v5", seed=7)
    here = ids(where)[0]
    facts = compare(Compare(runs=(here[:-1], there), store=(where, other), out=str(tmp_path), reach=900.0))
    assert [line["runs"] for line in facts["arms"]] == [[here], [there]]
    assert [line["reach"] for line in facts["arms"]] == [900.0, 900.0]
    assert here not in capsys.readouterr().out  # arms are told, not runs


def test_what_cannot_be_compared(where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = str(tmp_path / "empty.db")
    open_store(empty).close()
    for words, said in (
        (["compare", "--store", where], "got no run to compare"),
        (["compare", "x", "--all", "--store", where], "got runs and --all"),
        (["compare", "nothing", "--store", where, "--store", empty], "there is no run 'nothing'"),
        (["compare", "hopper", "--store", where], "4 runs begin with"),
        (["compare", "--all", "--store", empty], "there is no run in"),
        (["show", "--store", empty], "there is no run in"),
        (["show", "nothing", "--store", where], "there is no run 'nothing'"),
    ):
        assert main(words) == 2, words
        assert said in capsys.readouterr().err


def test_pictures_that_cannot_be_written_are_a_failure(
    where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["compare", "--all", "--store", where, "--out", str(tmp_path / "file")]) == 1
    assert "cannot write the pictures" in capsys.readouterr().err


def test_how_likely_kept_answers_were_is_told_also_below_nought() -> None:
    facts = {"held_out_accuracy": 0.9, "held_out_log_likelihood": -0.5, "coverage_90": None, "consistency": None}
    said = words_of(facts | {"weights": {"x": 1.0}})
    assert said["kept answers, log likelihood"] == "-0.5 nats an answer"
    assert "same question, same side" not in said
    assert "kept answers, log likelihood" not in words_of(facts | {"held_out_log_likelihood": None, "weights": {}})
