from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hiprl.cli.commands import Export, Import
from hiprl.cli.exchange import bring, export
from hiprl.cli.main import main
from hiprl.data.answer import choice
from hiprl.errors import InputError
from hiprl.store.store import open_store
from tests.store.test_exchange import a_run
from tests.store.writer import trajectory


@pytest.fixture
def where(tmp_path: Path) -> tuple[str, str]:
    """A store, and a run in it."""
    path = str(tmp_path / "runs.db")
    with open_store(path) as store:
        return path, a_run(store)


def test_answers_go_out_and_come_back_changed(where, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store, run = where
    file = tmp_path / "answers.jsonl"
    assert main(["export", run[:7], "--to", str(file), "--store", store, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"run": run, "file": str(file), "count": 4, "store": store}
    lines = file.read_text().splitlines()
    lines[-1] = json.dumps(json.loads(lines[-1]) | {"answer": {"form": "choice", "value": 1}, "judge": "ada"})
    file.write_text("\n".join(lines))
    assert main(["import", str(file), "--store", store, "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == {"run": run, "added": 1, "known": 3, "changed": 0, "open": 0, "store": store}
    assert "1 answer is new" in printed.err and f"hiprl relearn {run}" in printed.err
    with open_store(store) as opened:
        assert opened.answer_of(run, 3) == choice(True)


def test_who_changes_answers_of_a_script_is_told_that_the_run_itself_goes_on_without(
    where, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store, run = where
    file = tmp_path / "answers.jsonl"
    main(["export", run, "--to", str(file), "--store", store])
    lines = file.read_text().splitlines()
    lines[1] = json.dumps(json.loads(lines[1]) | {"answer": {"form": "number", "value": 7.0}})
    file.write_text("\n".join(lines))
    capsys.readouterr()
    assert main(["import", str(file), "--store", store, "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == {"run": run, "added": 1, "known": 2, "changed": 1, "open": 1, "store": store}
    assert "1 question is open" in printed.err and f"hiprl relearn {run} --store {store}" in printed.err
    assert "`hiprl resume` does not take changed answers in" in printed.err


@pytest.mark.parametrize("text", ["", "hello\n"])
def test_a_file_of_something_else_is_told_by_its_name_and_line(where, tmp_path: Path, text: str) -> None:
    file = tmp_path / "notes.txt"
    file.write_text(text)
    with pytest.raises(InputError, match=r"in .*notes\.txt, line 1: got .*, which does not begin a file of answers"):
        bring(Import(file=str(file), store=where[0]))


def test_trajectories_go_out(where, tmp_path: Path) -> None:
    store, run = where
    export(Export(run=run, to=str(tmp_path / "all.npz"), store=store))
    with np.load(tmp_path / "all.npz") as arrays:
        states, lengths, imagined = arrays["states"], arrays["lengths"], arrays["imagined"]
    for i, n in enumerate(lengths):
        row = trajectory(i)
        assert n == row.length and imagined[i] == row.imagined
        np.testing.assert_array_equal(states[i, : n + 1], row.states)
        assert np.isnan(states[i, n + 1 :]).all()


@pytest.mark.parametrize(
    ("to", "words"), [("answers.csv", r"\.jsonl the questions"), ("nowhere/answers.jsonl", "cannot write")]
)
def test_a_file_that_cannot_be_written(where, tmp_path: Path, to: str, words: str) -> None:
    store, run = where
    with pytest.raises(InputError, match=words):
        export(Export(run=run, to=str(tmp_path / to), store=store))


def test_a_file_that_cannot_be_read(where, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        bring(Import(file=str(tmp_path / "none.jsonl"), store=where[0]))
    (tmp_path / "some.jsonl").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="it is not text"):
        bring(Import(file=str(tmp_path / "some.jsonl"), store=where[0]))


def test_a_file_of_another_program_is_read(where, tmp_path: Path) -> None:
    store, run = where
    head = {"schema": "hiprl-answers", "version": 1, "run": run}
    line = {"k": 3, "answer": {"form": "choice", "value": 1}, "judge": "a\xa0b"}
    file = tmp_path / "answers.jsonl"
    file.write_text("\ufeff" + json.dumps(head) + "\r\n" + json.dumps(line, ensure_ascii=False) + "\r\n", "utf-8")
    with pytest.raises(InputError, match="got the judge"):
        bring(Import(file=str(file), store=store))  # a no-break space is nothing to be seen
    file.write_text(file.read_text("utf-8").replace("\xa0", " "), "utf-8")
    assert bring(Import(file=str(file), store=store))["added"] == 1
