"""The tables. Facts are only added; leases and claims change, and checkpoints but the newest two are dropped."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Dialect

HEAD = "0006"
"""Revision of the newest migration: what these tables are."""
VERSION_TABLE = "hiprl_version"
"""Where a store keeps its revision. A database without it is not ours."""


class Utc(sa.TypeDecorator[datetime]):
    """A moment in UTC, also in SQLite, which knows no time zones."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Json(sa.TypeDecorator[Any]):
    """Plain values as JSON text; NaN and infinities are kept. Scalars and arrays become numbers and lists."""

    impl = sa.Text
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> str:
        return json.dumps(value, default=lambda array: array.tolist())

    def process_result_value(self, value: str | None, dialect: Dialect) -> Any:
        return None if value is None else json.loads(value)


metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite counts up by itself only in a column of type INTEGER.
_Number = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def _of_run() -> sa.Column[str]:
    return sa.Column("run_id", sa.ForeignKey("runs.id"), primary_key=True)


def _created_at() -> sa.Column[datetime]:
    return sa.Column("created_at", Utc, nullable=False)


runs = sa.Table(
    "runs",
    metadata,
    sa.Column("id", sa.Text, primary_key=True),
    _created_at(),
    sa.Column("env", sa.Text, nullable=False),
    sa.Column("seed", sa.BigInteger, nullable=False),
    sa.Column("spec", Json, nullable=False),  # with env, seed and versions enough to do the run again
    sa.Column("versions", Json, nullable=False),
)

leases = sa.Table(
    "leases",
    metadata,
    _of_run(),
    sa.Column("host", sa.Text, nullable=False),
    sa.Column("pid", sa.BigInteger, nullable=False),
    sa.Column("token", sa.Text, nullable=False),  # tells two leases of one process apart
    sa.Column("expires_at", Utc, nullable=False),
)

trajectories = sa.Table(
    "trajectories",
    metadata,
    _of_run(),
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("kind", sa.Text, sa.CheckConstraint("kind IN ('random', 'policy')", name="kind"), nullable=False),
    sa.Column("states", sa.LargeBinary, nullable=False),  # .npy bytes without padding: (length + 1, p)
    sa.Column("actions", sa.LargeBinary, nullable=False),  # (length, q)
    sa.Column("rewards", sa.LargeBinary, nullable=False),  # (length,)
    sa.Column("length", sa.Integer, nullable=False),
    sa.Column("terminated", sa.Boolean, nullable=False),
    sa.Column("imagined", sa.Boolean, nullable=False, server_default=sa.false()),  # nobody executed it
    sa.Column("film", sa.LargeBinary),  # what a person is shown of it, `hiprl.data.film`
)

scenes = sa.Table(
    "scenes",
    metadata,
    _of_run(),
    sa.Column("scene", Json, nullable=False),  # what the films of a run play in
)

goals = sa.Table(
    "goals",
    metadata,
    sa.Column("id", _Number, primary_key=True),  # the greatest is the newest, and the newest counts
    sa.Column("run_id", sa.ForeignKey("runs.id"), nullable=False, index=True),
    sa.Column("words", sa.Text, nullable=False),  # what a judge wants to be done
    _created_at(),
)

enough = sa.Table(
    "enough",
    metadata,
    _of_run(),
    sa.Column("judge", sa.Text, nullable=False),  # who said that no more is to be asked
    _created_at(),
)

questions = sa.Table(
    "questions",
    metadata,
    sa.Column("id", _Number, primary_key=True),
    sa.Column("run_id", sa.ForeignKey("runs.id"), nullable=False),
    sa.Column("k", sa.Integer, nullable=False),
    sa.Column("first", sa.Integer, nullable=False),  # trajectory of the first clip
    sa.Column("second", sa.Integer, nullable=False),  # of the second; of the first if there is but one
    _created_at(),
    sa.Column("clips", Json, nullable=False),  # [[trajectory, first step, at most so many or null], ...]
    sa.Column("at_hand", sa.Integer),  # how many trajectories there were; unknown in old stores
    sa.UniqueConstraint("run_id", "k"),
    sa.ForeignKeyConstraint(["run_id", "first"], ["trajectories.run_id", "trajectories.number"]),
    sa.ForeignKeyConstraint(["run_id", "second"], ["trajectories.run_id", "trajectories.number"]),
)

answers = sa.Table(
    "answers",
    metadata,
    sa.Column("id", _Number, primary_key=True),  # the greatest is the newest, and the newest counts
    sa.Column("question_id", sa.ForeignKey("questions.id"), nullable=False, index=True),
    sa.Column("g", sa.Double),  # a number that was said; > 0: the question's first clip is better
    sa.Column("judge", sa.Text, nullable=False),
    sa.Column("swapped", sa.Boolean, nullable=False),  # the judge was shown the second one first
    _created_at(),
    sa.Column("said", Json, nullable=False),  # the whole answer, `Answer.plain()`
)

claims = sa.Table(
    "claims",
    metadata,
    sa.Column("question_id", sa.ForeignKey("questions.id"), primary_key=True, autoincrement=False),
    sa.Column("judge", sa.Text, nullable=False),  # who looks at it just now; nobody else is asked until it expires
    sa.Column("expires_at", Utc, nullable=False),
)

episodes = sa.Table(
    "episodes",
    metadata,
    _of_run(),
    sa.Column("k", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("facts", Json, nullable=False),
    _created_at(),
)

checkpoints = sa.Table(
    "checkpoints",
    metadata,
    _of_run(),
    sa.Column("k", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("blob", sa.LargeBinary, nullable=False),
    _created_at(),
)

finals = sa.Table(
    "finals",
    metadata,
    _of_run(),
    sa.Column("facts", Json, nullable=False),
    sa.Column("policy", sa.LargeBinary, nullable=False),
    _created_at(),
)

pages = sa.Table(
    "pages",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("secret", sa.Text, nullable=False),  # by which all pages on this store know who came in
    _created_at(),
    sa.CheckConstraint("number = 1", name="one"),
)
