"""Questions and answers of a run as JSON Lines: taken away, answered elsewhere, brought back.

The first line names the schema and the run. Each further line is an answer with its question, in the order in which
they were given, or a question that is still open, with `null` for its answer. `docs/commands.md` has the schema.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from hiprl.data.answer import Answer
from hiprl.data.words import hidden_in, seen_of
from hiprl.errors import HiprlError, InputError
from hiprl.store.once import refuse_unfitting
from hiprl.store.rows import ClipRow, QuestionRow, RunRow
from hiprl.store.store import Store

SCHEMA = "hiprl-answers"
VERSION = 1
ENTRIES = {"k", "clips", "answer", "judge", "swapped", "at"}
"""Of a line; all but k and the answer may be left out."""


class Given(NamedTuple):
    """An answer that came from elsewhere."""

    k: int
    answer: Answer
    judge: str
    swapped: bool


class Imported(NamedTuple):
    """What came of an import."""

    run: str
    added: int
    known: int
    """Answers that were there already."""
    changed: int
    """New ones to questions that had another answer."""
    open: int
    """Questions of the run that have none yet."""


def exported(store: Store, run_id: str) -> Iterator[str]:
    """The lines of a file with all questions and answers of a run."""
    row = store.run(run_id)
    questions = {question.k: question for question in store.questions(run_id)}
    yield json.dumps({"schema": SCHEMA, "version": VERSION, "run": run_id, "env": row.env})
    for answer in store.answers(run_id):
        said = {"answer": answer.answer.plain(), "judge": answer.judge, "swapped": answer.swapped}
        yield json.dumps(_asked(questions[answer.k]) | said | {"at": answer.created_at.isoformat()})
    for question in questions.values():
        if question.answer is None:
            yield json.dumps(_asked(question) | {"answer": None})


def imported(store: Store, lines: Iterable[str], *, judge: str = "import") -> Imported:
    """Takes answers in: all of them or, if one cannot be used, none.

    What the same judge said of the same question before is known, as often as it was said: a file that is brought
    twice changes nothing the second time, and no correction made since is undone.

    Args:
        store: where the run is.
        lines: of a file as `exported` writes it; what an answer does not say of itself has a default.
        judge: who answered, where a line does not say.

    Raises:
        InputError: it is no such file, or of a newer version; the run or a question is not in the store; or an answer
            does not fit its question.
    """
    numbered = ((n, line) for n, line in enumerate(lines, 1) if line.strip())
    run_id = _run_of(*next(numbered, (1, "")))
    run = store.run(run_id)
    questions = {question.k: question for question in store.questions(run_id)}
    there = Counter((row.k, row.answer, row.judge) for row in store.answers(run_id))
    newest: dict[int, Given] = {}
    given, known = [], 0
    for n, line in numbered:
        try:
            found = _read(line, questions, run, judge)
        except HiprlError as e:
            raise InputError(f"line {n}: {e} Nothing was imported.") from e
        if found is None:
            continue
        said = found.k, found.answer, found.judge
        if there[said]:
            there[said] -= 1
            known += 1
        elif found.k in newest and newest[found.k][:3] == said:  # twice in a row is once
            known += 1
        else:
            given.append(found)
        newest[found.k] = found
    added = store.answer_all(run_id, given)
    changed = len({one.k for one in given if questions[one.k].answer is not None})
    still_open = len(store.questions(run_id, unanswered=True))
    return Imported(run_id, added, known + len(given) - added, changed, still_open)


def _asked(question: QuestionRow) -> dict[str, Any]:
    clips = [{"trajectory": clip.of, "start": clip.start, "steps": clip.length} for clip in question.clips]
    return {"k": question.k, "clips": clips}


def _object(line: str) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _run_of(n: int, line: str) -> str:
    """The run that a file is about, from its first line."""
    head = _object(line) or {}
    if head.get("schema") != SCHEMA or not isinstance(head.get("run"), str):
        raise InputError(
            f"line {n}: got {line.strip()[:60]!r}, which does not begin a file of answers: its first line names the "
            f"schema {SCHEMA!r}, its version and the run. See what `hiprl export RUN --to answers.jsonl` writes."
        )
    if head.get("version") != VERSION:
        raise InputError(
            f"line {n}: got answers of version {head.get('version')!r}; this hiprl reads version {VERSION}. "
            "Install the hiprl that wrote the file, or a newer one."
        )
    return head["run"]


def _read(line: str, questions: dict[int, QuestionRow], run: RunRow, judge: str) -> Given | None:
    """The answer in a line; None for a question that is still open."""
    found = _object(line)
    if found is None:
        raise InputError(f"got {line.strip()[:60]!r}; a JSON object is needed. See what `hiprl export` writes.")
    strange = sorted(set(found) - ENTRIES)
    if strange:
        raise InputError(
            f"got the entries {', '.join(map(repr, strange))}; an answer has {', '.join(sorted(ENTRIES))}. "
            "Leave out the others, or mend their names."
        )
    question = questions.get(found["k"]) if type(found.get("k")) is int else None
    if question is None:
        raise InputError(
            f"got an answer to question {found.get('k')!r}, which run {run.id} does not ask; the number of one of its "
            f"questions is needed. Look at them with `hiprl export {run.id} --to answers.jsonl`."
        )
    if "clips" in found and _clips(found["clips"]) != question.clips:
        raise InputError(
            f"got question {question.k} about other clips than run {run.id} asks about; "
            f"({', '.join(map(str, question.clips))}) are needed. Export the questions again, and answer those."
        )
    said = found.get("answer")
    if said is None:
        return None
    if not isinstance(said, dict):
        raise InputError(f"got the answer {said!r}; an object with its form and value is needed. See `hiprl export`.")
    by, swapped = found.get("judge", judge), found.get("swapped", False)
    if not isinstance(by, str) or not seen_of(by).strip() or hidden_in(by) or not isinstance(swapped, bool):
        raise InputError(
            f"got the judge {by!r} and swapped {swapped!r}; a name, and true or false, are needed. "
            "Leave both out if they are not known."
        )
    answer = Answer.taken(said)
    refuse_unfitting(run.id, question.k, answer, len(question.clips), numbers_only=run.numbers_only)
    return Given(question.k, answer, by, swapped)


def _clips(plain: Any) -> tuple[ClipRow, ...] | None:
    """The clips of a line; None if they are none."""
    try:
        return tuple(ClipRow(clip["trajectory"], clip["start"], clip["steps"]) for clip in plain)
    except (KeyError, TypeError):
        return None
