"""Adds what a resumed run adds again: the same is stored once, another is refused."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, NoReturn

import sqlalchemy as sa

from hiprl.errors import InputError, StoreError
from hiprl.store.rows import TrajectoryRow
from hiprl.store.schema import checkpoints, episodes, finals, questions, runs, trajectories

_KEPT_CHECKPOINTS = 2


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
        f"{guess}`hiprl show` lists all runs."
    )


def add_trajectory(connection: sa.Connection, run_id: str, row: TrajectoryRow) -> None:
    """A trajectory under its number."""
    mine = (trajectories.c.run_id == run_id) & (trajectories.c.number == row.number)
    stored = connection.execute(sa.select(trajectories).where(mine)).one_or_none()
    if stored is None:
        connection.execute(sa.insert(trajectories).values(run_id=run_id, **row.values()))
        return
    difference = TrajectoryRow.read(stored).differs_from(row)
    if difference:
        _refuse_another(run_id, f"trajectory {row.number}: {difference}")


def add_question(connection: sa.Connection, run_id: str, k: int, first: int, second: int) -> int:
    """The question of episode k; gives its id."""
    mine = (questions.c.run_id == run_id) & (questions.c.k == k)
    stored = connection.execute(sa.select(questions).where(mine)).one_or_none()
    if stored is None:
        row = {"run_id": run_id, "k": k, "first": first, "second": second, "created_at": datetime.now(UTC)}
        return connection.execute(sa.insert(questions).values(row).returning(questions.c.id)).scalar_one()
    if (stored.first, stored.second) != (first, second):
        pairs = f"({stored.first}, {stored.second}) and ({first}, {second})"
        _refuse_another(run_id, f"the question of episode {k}: it compares {pairs}")
    return stored.id


def add_episode(connection: sa.Connection, run_id: str, k: int, facts: Mapping[str, Any], checkpoint: bytes) -> None:
    """The facts of episode k and the state after it; drops all checkpoints but the newest."""
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
