"""Which questions there are, and whose turn one is: no two judges look at the same one at the same time."""

from __future__ import annotations

from datetime import timedelta

import sqlalchemy as sa

from hiprl.store.engine import now
from hiprl.store.rows import QuestionRow
from hiprl.store.schema import answers, claims, questions


def all_asked(connection: sa.Connection, run_id: str | None, *, unanswered: bool) -> list[QuestionRow]:
    """The questions of a run, or of all runs, oldest first, with their newest answers; on request open ones only."""
    newest = sa.select(sa.func.max(answers.c.id)).where(answers.c.question_id == questions.c.id)
    newest = newest.correlate(questions).scalar_subquery()
    query = sa.select(questions, answers.c.said).order_by(questions.c.id)
    query = query.select_from(questions.outerjoin(answers, answers.c.id == newest))
    if run_id is not None:
        query = query.where(questions.c.run_id == run_id)
    if unanswered:
        query = query.where(answers.c.id.is_(None))
    return [QuestionRow.read(row) for row in connection.execute(query)]


def counted(connection: sa.Connection, run_id: str) -> tuple[int, int]:
    """How many questions a run has, and how many of them are answered."""
    of_run = questions.c.run_id == run_id
    total = sa.select(sa.func.count()).select_from(questions).where(of_run)
    answered = sa.select(sa.func.count(answers.c.question_id.distinct()))
    answered = answered.select_from(answers.join(questions)).where(of_run)
    return connection.execute(total).scalar_one(), connection.execute(answered).scalar_one()


def taken(connection: sa.Connection, run_id: str, judge: str, *, seconds: float) -> QuestionRow | None:
    """The oldest open question that nobody else looks at; it is this judge's for so long. The run is locked before.

    What this judge has answered before comes last: it waits for another judge.
    """
    free = (claims.c.question_id.is_(None)) | (claims.c.judge == judge) | (claims.c.expires_at < now(connection))
    asked = questions.alias()
    known = sa.select(asked.c.clips).join(answers, answers.c.question_id == asked.c.id)
    known = known.where(asked.c.run_id == run_id, answers.c.judge == judge)
    query = (
        sa.select(questions, sa.null().label("said"))
        .select_from(questions.outerjoin(claims).outerjoin(answers))
        .where(questions.c.run_id == run_id, answers.c.id.is_(None), free)
        .order_by(questions.c.clips.in_(known), questions.c.k)
        .limit(1)
    )
    row = connection.execute(query).one_or_none()
    if row is None:
        return None
    connection.execute(sa.delete(claims).where(claims.c.question_id == row.id))
    until = now(connection) + timedelta(seconds=seconds)
    connection.execute(sa.insert(claims).values(question_id=row.id, judge=judge, expires_at=until))
    return QuestionRow.read(row)


def untaken(connection: sa.Connection, run_id: str) -> int:
    """How many open questions nobody looks at."""
    free = (claims.c.question_id.is_(None)) | (claims.c.expires_at < now(connection))
    query = sa.select(sa.func.count()).select_from(questions.outerjoin(claims).outerjoin(answers))
    return connection.execute(query.where(questions.c.run_id == run_id, answers.c.id.is_(None), free)).scalar_one()
