"""Looks up what a store has one of: a run by its id, the newest trajectory, the secret of its pages."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from hiprl.errors import InputError
from hiprl.store.once import refuse_run
from hiprl.store.rows import Kind, RunRow
from hiprl.store.schema import pages, runs, trajectories


def run_called(connection: sa.Connection, run_id: str, name: str) -> RunRow:
    """The run of this id in the store of this name."""
    row = connection.execute(sa.select(runs).where(runs.c.id == run_id)).one_or_none()
    return RunRow(**row._mapping) if row is not None else refuse_run(connection, run_id, name)


def run_that_begins(connection: sa.Connection, prefix: str, name: str) -> RunRow:
    """The only run whose id is, or begins with, `prefix`."""
    begins = runs.c.id.startswith(prefix, autoescape=True)
    rows = connection.execute(sa.select(runs).where(begins).order_by(runs.c.id)).all()
    rows = [row for row in rows if row.id == prefix] or rows
    if not prefix or not rows:
        refuse_run(connection, prefix, name)
    if len(rows) > 1:
        some = ", ".join(row.id for row in rows[:5]) + (", ..." if len(rows) > 5 else "")
        raise InputError(f"{len(rows)} runs begin with {prefix!r} ({some}); one is needed. Write more of its id.")
    return RunRow(**rows[0]._mapping)


def newest_executed(connection: sa.Connection, run_id: str, kind: Kind) -> int | None:
    """Number of the newest executed trajectory of this kind."""
    mine = (trajectories.c.run_id == run_id) & ~trajectories.c.imagined & (trajectories.c.kind == kind)
    return connection.scalar(sa.select(sa.func.max(trajectories.c.number)).where(mine))


def executed_before(connection: sa.Connection, run_id: str, number: int) -> int:
    """How many trajectories were executed before that of this number."""
    mine = (trajectories.c.run_id == run_id) & ~trajectories.c.imagined & (trajectories.c.number < number)
    return connection.execute(sa.select(sa.func.count()).where(mine)).scalar_one()


def page_secret(connection: sa.Connection) -> str:
    """The secret of the store's pages; of several who ask for it first, one makes it, and all get that one."""
    insert = {"sqlite": sqlite.insert, "postgresql": postgresql.insert}[connection.dialect.name](pages)
    row = {"number": 1, "secret": secrets.token_urlsafe(32), "created_at": datetime.now(UTC)}
    connection.execute(insert.values(row).on_conflict_do_nothing())
    return connection.execute(sa.select(pages.c.secret)).scalar_one()
