"""Adds what a resumed run adds again: the same is stored once, another is refused."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NoReturn

import sqlalchemy as sa

from hiprl.data.answer import Answer
from hiprl.errors import Answered, InputError, StoreError
from hiprl.store.rows import ClipRow, TrajectoryRow, number_of, numbers_only
from hiprl.store.schema import answers, checkpoints, episodes, finals, questions, runs, trajectories

trajectory_columns = [column for column in trajectories.c if column.name != "film"]  # which is large, and seldom wanted
_KEPT_CHECKPOINTS = 2
_MOST_CLIPS = 8  # of a question: more cannot be kept in mind


def lock_run(connection: sa.Connection, run_id: str, name: str) -> None:
    """Make other writers of this run wait until the transaction ends; in SQLite they wait anyway."""
    query = sa.select(runs.c.id).where(runs.c.id == run_id).with_for_update()
    if connection.execute(query).first() is None:
        refuse_run(connection, run_id, name)


def refuse_run(connection: sa.Connection, run_id: str, name: str) -> NoReturn:
    """Say that the store of this name has no such run, and which ids are near."""
    near = difflib.get_close_matches(run_id, connection.scalars(sa.select(runs.c.id)).all())
    guess = f"Did you mean {' or '.join(near)}? " if near else ""
    raise InputError(
        f"there is no run {run_id!r} in {name}; the id of a run in this store is needed. "
        f"{guess}`hiprl show --store {name}` lists all runs."
    )


def add_first(connection: sa.Connection, table: sa.Table, run_id: str, **values: Any) -> None:
    """A row of a run in a table that holds one for each; the first one stays."""
    if connection.execute(sa.select(table.c.run_id).where(table.c.run_id == run_id)).first() is None:
        connection.execute(sa.insert(table).values(run_id=run_id, **values))


def add_trajectory(connection: sa.Connection, run_id: str, row: TrajectoryRow, film: bytes | None = None) -> None:
    """A trajectory under its number."""
    mine = (trajectories.c.run_id == run_id) & (trajectories.c.number == row.number)
    stored = connection.execute(sa.select(*trajectory_columns).where(mine)).one_or_none()
    if stored is None:
        connection.execute(sa.insert(trajectories).values(run_id=run_id, film=film, **row.values()))
        return
    difference = TrajectoryRow.read(stored).differs_from(row)
    if difference:
        _refuse_another(run_id, f"trajectory {row.number}: {difference}")


def add_question(connection: sa.Connection, run_id: str, k: int, clips: Sequence[ClipRow]) -> int:
    """The question of episode k; gives its id."""
    clips = [ClipRow(*clip.plain()) for clip in clips]  # numbers of NumPy and JAX become Python's
    _check_clips(connection, run_id, clips)
    mine = (questions.c.run_id == run_id) & (questions.c.k == k)
    stored = connection.execute(sa.select(questions).where(mine)).one_or_none()
    if stored is None:
        row = {"first": clips[0].of, "second": clips[:2][-1].of, "clips": [clip.plain() for clip in clips]}
        at_hand = sa.select(sa.func.count()).where(trajectories.c.run_id == run_id).scalar_subquery()
        row |= {"run_id": run_id, "k": k, "created_at": datetime.now(UTC), "at_hand": at_hand}
        return connection.execute(sa.insert(questions).values(row).returning(questions.c.id)).scalar_one()
    before = [ClipRow(*clip) for clip in stored.clips]
    if before != clips:
        both = " and ".join(f"({', '.join(map(str, some))})" for some in (before, clips))
        _refuse_another(run_id, f"the question of episode {k}: it is about {both}")
    return stored.id


def _check_clips(connection: sa.Connection, run_id: str, clips: Sequence[ClipRow]) -> None:
    """Refuse a question about too few or too many clips, or about steps that no stored trajectory has."""
    if not 1 <= len(clips) <= _MOST_CLIPS:
        raise InputError(
            f"got {len(clips)} clips to ask about; a question is about 1 to {_MOST_CLIPS}. "
            "Name one or two, or spread many over several questions."
        )
    mine = (trajectories.c.run_id == run_id) & trajectories.c.number.in_({clip.of for clip in clips})
    rows = connection.execute(sa.select(trajectories.c.number, trajectories.c.length).where(mine))
    lengths = {row.number: row.length for row in rows}
    for clip in clips:
        if clip.of not in lengths:
            raise InputError(
                f"got a clip of trajectory {clip.of}, and run {run_id!r} has none of this number; only what is "
                "stored can be asked about. Count from 0, and add the trajectory before the question."
            )
        steps = lengths[clip.of]
        if not 0 <= clip.start < steps:
            raise InputError(
                f"got a clip that starts at step {clip.start} of trajectory {clip.of}, which has {steps}; "
                f"a step from 0 to {steps - 1} is needed. Start it there."
            )
        if clip.length is not None and clip.length < 1:
            raise InputError(
                f"got a clip of {clip.length} steps of trajectory {clip.of}; at least 1 is needed. "
                "Take more, or None to go on to its end."
            )


def add_answer(
    connection: sa.Connection, run_id: str, k: int, answer: Answer, judge: str, swapped: bool, *, own: bool = False
) -> bool:
    """An answer to episode k's question; False, and nothing, if its newest one is this judge's and the same.

    With `own`, a question that others have answered and this judge has not is refused.
    """
    mine = (questions.c.run_id == run_id) & (questions.c.k == k)
    query = sa.select(questions.c.id, questions.c.clips, runs.c.spec).join(runs).where(mine)
    query = query.with_for_update(of=questions)  # or what is said twice at once would be kept twice
    asked = connection.execute(query).one_or_none()
    if asked is None:
        raise InputError(
            f"run {run_id} asks nothing in episode {k}; an answer needs its question. "
            "Wait until the episode was executed, or check the run's id."
        )
    refuse_unfitting(run_id, k, answer, len(asked.clips), numbers_only=numbers_only(asked.spec))
    g = number_of(answer)
    said = answer.plain() | ({} if g is None else {"value": g})
    given = sa.select(answers.c.said, answers.c.judge).where(answers.c.question_id == asked.id)
    before = [(one.said, one.judge) for one in connection.execute(given.order_by(answers.c.id))]
    if before and before[-1] == (said, judge):
        return False
    if own and before and all(name != judge for _, name in before):
        raise Answered(
            f"question {k} was answered by {before[-1][1]} in the meantime; a question is one judge's. "
            "Go on with the next one."
        )
    row = {"g": g, "said": said, "judge": judge, "swapped": swapped, "created_at": datetime.now(UTC)}
    connection.execute(sa.insert(answers).values(question_id=asked.id, **row))
    return True


def refuse_unfitting(run_id: str, k: int, answer: Answer, clips: int, *, numbers_only: bool) -> None:
    """Raises InputError if an answer is not about the clips of episode k's question, or of no use to its run."""
    if numbers_only and answer.form != "number":
        raise InputError(
            f"got an answer of the form {answer.form!r} for run {run_id}, whose reward is the paper's network; that "
            "learns from numbers alone. Give the form `number`, or leave it out."
        )
    if answer.form != "unsure" and answer.items != clips:
        raise InputError(
            f"got an answer of the form {answer.form!r}, which is about {_counted(answer.items)}, where run "
            f"{run_id} asks in episode {k} about {_counted(clips)}; it must be about as many. "
            f"Give {_fitting(clips)}, or say that you cannot tell."
        )


def _counted(n: int) -> str:
    return "1 clip" if n == 1 else f"{n} clips"


def _fitting(n: int) -> str:
    """An answer to a question about so many clips, in words."""
    return "a rating" if n == 1 else "one of the two, or a number" if n == 2 else f"a ranking of all {n}"


def add_episode(connection: sa.Connection, run_id: str, k: int, facts: Mapping[str, Any], checkpoint: bytes) -> None:
    """The facts of episode k and the state after it; drops all checkpoints but the two newest."""
    row = {"run_id": run_id, "k": k, "created_at": datetime.now(UTC)}
    mine = (checkpoints.c.run_id == run_id) & (checkpoints.c.k == k)
    done = sa.select(episodes.c.k).where(episodes.c.run_id == run_id, episodes.c.k == k)
    if connection.execute(done).first() is not None:
        stored = connection.execute(sa.select(checkpoints.c.blob).where(mine)).scalar()
        if stored not in (None, checkpoint):
            _refuse_another(run_id, f"the state after episode {k}")
        return
    connection.execute(sa.insert(episodes).values(facts=dict(facts), **row))
    connection.execute(sa.insert(checkpoints).values(blob=checkpoint, **row))
    of_run = sa.select(checkpoints.c.k).where(checkpoints.c.run_id == run_id)
    kept = connection.scalars(of_run.order_by(checkpoints.c.k.desc()).limit(_KEPT_CHECKPOINTS)).all()
    old = (checkpoints.c.run_id == run_id) & checkpoints.c.k.not_in(kept)
    connection.execute(sa.delete(checkpoints).where(old))


def add_final(connection: sa.Connection, run_id: str, facts: Mapping[str, Any], policy: bytes) -> None:
    """The summary of a finished run and its policy."""
    stored = connection.execute(sa.select(finals.c.policy).where(finals.c.run_id == run_id)).scalar()
    if stored is None:
        row = {"facts": dict(facts), "policy": policy, "created_at": datetime.now(UTC)}
        connection.execute(sa.insert(finals).values(run_id=run_id, **row))
    elif stored != policy:
        _refuse_another(run_id, "the policy at its end")


def _refuse_another(run_id: str, what: str) -> NoReturn:
    raise StoreError(
        f"run {run_id} cannot be continued bit for bit here: done again, it does not give what is stored "
        f"({what}); that needs the machine and the versions that began it. "
        "Resume it there (the run's row lists its versions), or start a new run."
    )
