from __future__ import annotations

import json

import pytest

from hiprl.data.answer import EQUALLY_GOOD, choice, level, number
from hiprl.errors import InputError
from hiprl.store.exchange import exported, imported
from hiprl.store.rows import ClipRow
from hiprl.store.store import Store
from tests.store.writer import trajectory


def a_run(store: Store, *, answered: bool = True) -> str:
    """Three questions; the first two are answered, the second one twice."""
    run_id = store.add_run("Hopper-v5", 3, {}, {})
    for i in range(3):
        store.add_trajectory(run_id, i, trajectory(i), "random")
    store.ask(run_id, 1, [ClipRow(0), ClipRow(1)])
    store.ask(run_id, 2, [ClipRow(2, 1, 2), ClipRow(0, 0, 2)])
    store.ask(run_id, 3, [ClipRow(2), ClipRow(1)])
    if answered:
        store.answer(run_id, 1, number(-2.5), "exact")
        store.answer(run_id, 2, choice(True), "ada", swapped=True)
        store.answer(run_id, 2, EQUALLY_GOOD, "ada")
    return run_id


def said(store: Store, run_id: str) -> list[tuple]:
    return [(row.k, row.answer, row.judge, row.swapped) for row in store.answers(run_id)]


def changed(lines: list[str], n: int, **changes: object) -> list[str]:
    """The lines with other entries in one of them."""
    return [*lines[:n], json.dumps(json.loads(lines[n]) | changes), *lines[n + 1 :]]


def test_a_file_tells_every_answer_and_every_open_question(store: Store) -> None:
    run_id = a_run(store)
    head, *rest = map(json.loads, exported(store, run_id))
    assert head == {"schema": "hiprl-answers", "version": 1, "run": run_id, "env": "Hopper-v5"}
    assert [(line["k"], line["answer"] and line["answer"]["form"]) for line in rest] == [
        (1, "number"),
        (2, "choice"),
        (2, "equal"),
        (3, None),
    ]
    assert rest[1]["clips"] == [
        {"trajectory": 2, "start": 1, "steps": 2},
        {"trajectory": 0, "start": 0, "steps": 2},
    ]
    assert rest[0]["clips"][0]["steps"] is None and rest[1]["judge"] == "ada" and rest[1]["swapped"]


def test_answers_that_come_back_are_known(store: Store) -> None:
    run_id = a_run(store)
    before = said(store, run_id)
    # the second question's first answer was corrected, and stays so
    assert imported(store, exported(store, run_id)) == (run_id, 0, 3, 0, 1)
    assert said(store, run_id) == before


def test_a_run_is_answered_elsewhere(store: Store) -> None:
    run_id = a_run(store, answered=False)
    lines = list(exported(store, run_id))
    for n, answer in enumerate((number(7), level(-2, 5), choice(False)), 1):
        lines = changed(lines, n, answer=answer.plain(), judge="bo")
    assert imported(store, [*lines, "", "  "]) == (run_id, 3, 0, 0, 0)
    assert said(store, run_id) == [
        (1, number(7.0), "bo", False),
        (2, level(-2, 5), "bo", False),
        (3, choice(False), "bo", False),
    ]
    assert not store.questions(run_id, unanswered=True)


def test_a_line_says_as_little_as_it_wants(store: Store) -> None:
    run_id = a_run(store, answered=False)
    head = {"schema": "hiprl-answers", "version": 1, "run": run_id}
    line = {"k": 3, "answer": {"form": "choice", "value": 1}}
    assert imported(store, [json.dumps(head), json.dumps(line)], judge="cy").added == 1
    assert said(store, run_id) == [(3, choice(True), "cy", False)]


@pytest.mark.parametrize(
    ("n", "changes", "words"),
    [
        (0, {"schema": "other"}, "does not begin a file of answers"),
        (0, {"version": 2}, "version 2; this hiprl reads version 1"),
        (0, {"version": "1"}, "version '1'; this hiprl reads version 1"),
        (0, {"run": "hopper-none"}, "no run 'hopper-none'"),
        (3, {"k": 9}, "line 4: got an answer to question 9, which run .* does not ask"),
        (3, {"k": "3"}, "question '3'"),
        (3, {"k": True}, "question True"),
        (3, {"k": 2}, "about other clips"),
        (3, {"clips": [{"trajectory": 2}]}, "about other clips"),
        (3, {"clips": 5}, "about other clips"),
        (3, {"answer": {"form": "thumbs"}}, "the form 'thumbs'"),
        (3, {"answer": {"form": "number", "value": float("nan")}}, "a finite number is needed"),
        (3, {"answer": {"form": "number", "value": 1e39}}, r"got the number 1e\+39; one from -1e\+15"),
        (3, {"answer": {"form": "rating", "value": 1, "levels": 5}}, "line 4: .* about 1 clip.* Nothing was imported"),
        (3, {"answer": 1}, "an object with its form"),
        (3, {"judge": ""}, "got the judge ''"),
        (3, {"judge": "\ud800"}, "got the judge '.ud800'"),
        (3, {"judge": "a\nb"}, "got the judge"),
        (3, {"swaped": True}, "line 4: got the entries 'swaped'; an answer has .*swapped"),
        (3, {"swapped": 1}, "swapped 1"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_is_taken(store: Store, n: int, changes: dict, words: str) -> None:
    run_id = a_run(store, answered=False)
    lines = list(exported(store, run_id))
    for i in (1, 2, 3):
        lines = changed(lines, i, answer=choice(True).plain())
    with pytest.raises(InputError, match=words):
        imported(store, changed(lines, n, **changes))
    assert not said(store, run_id)


@pytest.mark.parametrize("text", ["", "[1]", "hello", '{"k": 1}', "[" * 100_000])
def test_a_file_that_is_none_is_refused(store: Store, text: str) -> None:
    with pytest.raises(InputError):
        imported(store, text.splitlines())


def test_the_same_said_twice_is_said_once(store: Store) -> None:
    run_id = a_run(store)
    assert not store.answer(run_id, 1, number(-2.5), "exact")
    assert store.answer(run_id, 1, number(-2.5), "ada")  # somebody else agrees
    assert store.answer(run_id, 1, number(2.5), "ada")
    assert store.answer(run_id, 1, number(-2.5), "ada")  # and changes their mind back
    assert len(said(store, run_id)) == 6


@pytest.mark.parametrize("at", [{}, {"at": "2026-01-02T03:04:05+00:00"}], ids=["no time", "a time"])
def test_a_file_that_comes_again_undoes_no_correction(store: Store, at: dict) -> None:
    run_id = a_run(store, answered=False)
    head = next(iter(exported(store, run_id)))
    file = [head]
    for k, answer in ((1, choice(True)), (1, choice(False)), (1, choice(True)), (2, number(0.1)), (2, number(0.1))):
        file.append(json.dumps({"k": k, "answer": answer.plain(), "judge": "bo", **at}))
    assert imported(store, file) == (run_id, 4, 1, 0, 1)  # 0.1 was said twice in a row
    assert store.answer(run_id, 1, choice(False), "bo") and store.answer(run_id, 2, choice(True), "cy")
    before = said(store, run_id)
    assert imported(store, file) == (run_id, 0, 5, 0, 1)
    assert said(store, run_id) == before and store.answer_of(run_id, 1) == choice(False)


def test_a_name_may_have_letters_that_join(store: Store) -> None:
    run_id = a_run(store, answered=False)
    line = {"k": 3, "answer": {"form": "choice", "value": 1}, "judge": "می\u200cگ"}
    assert imported(store, [next(iter(exported(store, run_id))), json.dumps(line)]).added == 1


def test_the_papers_network_is_brought_numbers_alone(store: Store) -> None:
    run_id = store.add_run("Hopper-v5", 3, {"config": {"reward": {"part": "NetworkConfig"}}}, {})
    for i in range(2):
        store.add_trajectory(run_id, i, trajectory(i), "random")
    store.ask(run_id, 1, [ClipRow(0), ClipRow(1)])
    head = next(iter(exported(store, run_id)))
    with pytest.raises(InputError, match=r"line 2: .*'choice'.* from numbers alone.* Nothing was imported"):
        imported(store, [head, json.dumps({"k": 1, "answer": choice(True).plain()})])
    assert imported(store, [head, json.dumps({"k": 1, "answer": number(2).plain()})]).added == 1
