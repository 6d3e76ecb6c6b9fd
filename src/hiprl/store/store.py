"""Opens a store; adds and looks up runs, trajectories, questions, answers, episodes and checkpoints."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from hiprl.data.answer import Answer
from hiprl.errors import InputError
from hiprl.store.engine import Database, connect
from hiprl.store.finding import executed_before, newest_executed, page_secret, run_called, run_that_begins
from hiprl.store.lease import Lease, Owner, hold, is_held
from hiprl.store.migrate import bring_up_to_date
from hiprl.store.once import (
    add_answer,
    add_episode,
    add_final,
    add_first,
    add_question,
    add_trajectory,
    lock_run,
    trajectory_columns,
)
from hiprl.store.rows import AnswerRow, ClipRow, Executed, Kind, QuestionRow, RunRow, TrajectoryRow
from hiprl.store.schema import (
    answers,
    checkpoints,
    enough,
    episodes,
    finals,
    goals,
    questions,
    runs,
    scenes,
    trajectories,
)
from hiprl.store.turns import all_asked, counted, taken, untaken

_LONGEST = 2**63 - 1  # of an integer in either database


def open_store(where: str | Path, *, create: bool = True, busy_seconds: float = 10.0) -> Store:
    """The store at a path (SQLite) or an address (PostgreSQL), made if there is none, migrated if it is old.

    Args:
        where: a file, or `postgresql+psycopg://user:password@host/database`.
        create: False refuses what is not yet a store.
        busy_seconds: how long to wait while another process writes.

    Raises:
        InputError: the path or address leads nowhere.
        StoreError: it is no store of ours, or of a newer version, or cannot be used.
    """
    database = connect(where, create=create, busy_seconds=busy_seconds)
    try:
        bring_up_to_date(database, create=create)
    except BaseException:
        database.engine.dispose()
        raise
    return Store(database)


class Store:
    """Runs and all that belongs to them. Threads may share one; each method is one transaction.

    Whatever is added twice (by a run that is resumed) must be the same bit for bit, and is stored once. All
    methods raise StoreError if the database cannot be used, and those that add InputError if there is no such
    run.
    """

    def __init__(self, database: Database):
        self._database = database

    @property
    def name(self) -> str:
        """Its path or address, without any password."""
        return self._database.name

    def close(self) -> None:
        """Close all connections."""
        self._database.engine.dispose()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Runs

    def add_run(self, env: str, seed: int, spec: Mapping[str, Any], versions: Mapping[str, str]) -> str:
        """A new run's id, such as `halfcheetah-7f3a`. The arguments must be enough to do the run again.

        Raises:
            InputError: the seed does not fit into 64 bits.
        """
        if not -_LONGEST <= seed <= _LONGEST:
            raise InputError(f"got the seed {seed}; it must fit into 64 bits. Take one such as {seed % 2**31}.")
        name = re.sub(r"[^a-z0-9]+", "-", re.sub(r"-v\d+$", "", env.split("/")[-1]).lower()).strip("-")[:60] or "run"
        with self._database.writing() as connection:
            run_id = f"{name}-{secrets.token_hex(2)}"
            while connection.execute(sa.select(runs.c.id).where(runs.c.id == run_id)).first():
                run_id = f"{name}-{secrets.token_hex(4)}"
            row = {"env": env, "seed": seed, "spec": dict(spec), "versions": dict(versions)}
            connection.execute(sa.insert(runs).values(id=run_id, created_at=datetime.now(UTC), **row))
        return run_id

    def run(self, run_id: str) -> RunRow:
        """The run of this id.

        Raises:
            InputError: there is none.
        """
        with self._database.reading() as connection:
            return run_called(connection, run_id, self.name)

    def find_run(self, prefix: str) -> RunRow:
        """The only run whose id is, or begins with, `prefix`; capitals do not count.

        Raises:
            InputError: there is none, or there are several.
        """
        with self._database.reading() as connection:
            return run_that_begins(connection, prefix.lower(), self.name)

    def runs(self) -> list[RunRow]:
        """All runs, oldest first."""
        with self._database.reading() as connection:
            rows = connection.execute(sa.select(runs).order_by(runs.c.created_at, runs.c.id))
            return [RunRow(**row._mapping) for row in rows]

    def lease(self, run_id: str, *, owner: Owner | None = None, seconds: float = 60.0) -> AbstractContextManager[Lease]:
        """The right to train a run, for the length of a `with`; a thread renews it.

        Args:
            run_id: of the run.
            owner: who trains; this process, if None.
            seconds: after how long a silence another trainer may take over. One whose process died on this
                machine is replaced at once.

        Raises:
            InputError: there is no such run, or another trainer is at it.
        """
        self.run(run_id)
        return hold(self._database, run_id, owner=owner, seconds=seconds)

    def trained(self, run_id: str) -> bool:
        """Whether a trainer is at a run: it has the lease, and lives as far as can be seen from here."""
        with self._database.reading() as connection:
            return is_held(connection, run_id)

    # Trajectories

    def add_trajectory(self, run_id: str, number: int, tau: Executed, kind: Kind, *, film: bytes | None = None) -> None:
        """Keep τ as number `number` of the run's T, with what a person is shown of it.

        Raises:
            StoreError: another one is stored under this number.
        """
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            add_trajectory(connection, run_id, TrajectoryRow.of(tau, number=number, kind=kind), film)

    def trajectory(self, run_id: str, number: int) -> TrajectoryRow:
        """One trajectory of a run.

        Raises:
            InputError: there is none of this number.
        """
        with self._database.reading() as connection:
            mine = (trajectories.c.run_id == run_id) & (trajectories.c.number == number)
            row = connection.execute(sa.select(*trajectory_columns).where(mine)).one_or_none()
        if row is None:
            raise InputError(
                f"run {run_id!r} has no trajectory {number}; the number of one of its own is needed. "
                "Count from 0, and check the run's id."
            )
        return TrajectoryRow.read(row)

    def trajectories(self, run_id: str) -> list[TrajectoryRow]:
        """T, in its order."""
        mine = sa.select(*trajectory_columns).where(trajectories.c.run_id == run_id)
        with self._database.reading() as connection:
            return [TrajectoryRow.read(row) for row in connection.execute(mine.order_by(trajectories.c.number))]

    def film(self, run_id: str, number: int) -> tuple[bytes | None, bool]:
        """What a person is shown of a trajectory, None if it was not filmed; and whether it was only imagined."""
        mine = (trajectories.c.run_id == run_id) & (trajectories.c.number == number)
        with self._database.reading() as connection:
            row = connection.execute(sa.select(trajectories.c.film, trajectories.c.imagined).where(mine)).one_or_none()
            return (None, False) if row is None else (row.film, row.imagined)

    def newest(self, run_id: str, kind: Kind) -> int | None:
        """Number of the newest executed trajectory of this kind; None if there is none."""
        with self._database.reading() as connection:
            return newest_executed(connection, run_id, kind)

    def executed_before(self, run_id: str, number: int) -> int:
        """How many trajectories were executed before that of this number."""
        with self._database.reading() as connection:
            return executed_before(connection, run_id, number)

    # What a person is told

    def secret(self) -> str:
        """By what the pages on this store know browsers that came in: made when it is asked for first."""
        with self._database.writing() as connection:
            return page_secret(connection)

    def set_scene(self, run_id: str, scene: Mapping[str, Any]) -> None:
        """Keep what the films of a run play in; the first one stays."""
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            add_first(connection, scenes, run_id, scene=dict(scene))

    def scene(self, run_id: str) -> dict[str, Any] | None:
        """What the films of a run play in; None if it has none."""
        with self._database.reading() as connection:
            return connection.execute(sa.select(scenes.c.scene).where(scenes.c.run_id == run_id)).scalar()

    def set_goal(self, run_id: str, words: str) -> None:
        """Keep what is wanted, in a judge's own words."""
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            connection.execute(sa.insert(goals).values(run_id=run_id, words=words, created_at=datetime.now(UTC)))

    def goal(self, run_id: str) -> str | None:
        """What is wanted, in a judge's own words; None while nobody has said."""
        query = sa.select(goals.c.words).where(goals.c.run_id == run_id).order_by(goals.c.id.desc()).limit(1)
        with self._database.reading() as connection:
            return connection.execute(query).scalar()

    def say_enough(self, run_id: str, judge: str) -> None:
        """Keep that this judge wants no more to be asked; the first one who said so stays."""
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            add_first(connection, enough, run_id, judge=judge, created_at=datetime.now(UTC))

    def enough(self, run_id: str) -> bool:
        """Whether a judge said that no more is to be asked."""
        with self._database.reading() as connection:
            return connection.execute(sa.select(enough.c.judge).where(enough.c.run_id == run_id)).first() is not None

    # Questions and answers

    def ask(self, run_id: str, k: int, clips: Sequence[ClipRow]) -> int:
        """The id of episode k's question: which of these clips is better, or how good is the only one?

        Raises:
            InputError: there are none or more than eight, or one shows steps that no stored trajectory has.
            StoreError: episode k asks about other clips.
        """
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            return add_question(connection, run_id, k, clips)

    def open_question(self, run_id: str, k: int, taus: Iterable[TrajectoryRow], clips: Sequence[ClipRow]) -> int:
        """`add_trajectory` and `ask` at once: what an episode must leave behind before a judge is asked."""
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            for tau in taus:
                add_trajectory(connection, run_id, tau)
            return add_question(connection, run_id, k, clips)

    def questions(self, run_id: str | None = None, *, unanswered: bool = False) -> list[QuestionRow]:
        """The questions of a run, or of all runs, oldest first; on request the open ones only."""
        with self._database.reading() as connection:
            return all_asked(connection, run_id, unanswered=unanswered)

    def asked(self, run_id: str) -> tuple[int, int]:
        """How many questions a run has, and how many of them are answered: counted, not read."""
        with self._database.reading() as connection:
            return counted(connection, run_id)

    def claim(self, run_id: str, judge: str, *, seconds: float = 60.0) -> QuestionRow | None:
        """The oldest open question of a run that nobody else is looking at; it is this judge's for a while.

        None if there is none. Two judges are never asked the same at the same time. What this judge has answered
        before is asked only if there is nothing else: it waits for another judge.
        """
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            return taken(connection, run_id, judge, seconds=seconds)

    def unseen(self, run_id: str) -> int:
        """How many open questions of a run no judge looks at just now."""
        with self._database.reading() as connection:
            return untaken(connection, run_id)

    def answer(
        self, run_id: str, k: int, answer: Answer, judge: str, *, swapped: bool = False, own: bool = False
    ) -> bool:
        """Keep an answer to episode k's question; it replaces earlier ones, which stay to be seen.

        Args:
            run_id: of the run.
            k: the episode.
            answer: what is said of the question's clips, in the question's own order.
            judge: who says so.
            swapped: whether the judge was shown the second one first.
            own: whether to refuse a question that others have answered and this judge has not.

        Returns:
            False if the newest one was this judge's and the same: said twice is said once.

        Raises:
            InputError: nothing is asked there, or the answer is about more or fewer clips than the question.
            Answered: it is another judge's.
        """
        with self._database.writing() as connection:
            return add_answer(connection, run_id, k, answer, judge, swapped, own=own)

    def answer_all(self, run_id: str, given: Iterable[tuple[int, Answer, str, bool]]) -> int:
        """`answer` for several (k, answer, judge, swapped): all or, if one is refused, none. How many were new."""
        with self._database.writing() as connection:
            return sum(add_answer(connection, run_id, *one) for one in given)

    def answer_of(self, run_id: str, k: int) -> Answer | None:
        """The newest answer to episode k's question; None while there is none."""
        return {row.k: row.answer for row in self.answers(run_id)}.get(k)

    def answers(self, run_id: str) -> list[AnswerRow]:
        """All answers in the order they were given, corrected ones too."""
        columns = (questions.c.k, answers.c.said, answers.c.judge, answers.c.swapped, answers.c.created_at)
        query = sa.select(*columns).join_from(answers, questions).where(questions.c.run_id == run_id)
        with self._database.reading() as connection:
            return [
                AnswerRow(k=k, answer=Answer.read(said), judge=judge, swapped=swapped, created_at=created_at)
                for k, said, judge, swapped, created_at in connection.execute(query.order_by(answers.c.id))
            ]

    # Episodes and the end

    def finish_episode(
        self,
        run_id: str,
        k: int,
        facts: Mapping[str, Any],
        checkpoint: bytes,
        *,
        taus: Iterable[tuple[TrajectoryRow, bytes | None]] = (),
    ) -> None:
        """Keep what episode k came to, and the state from which episode k + 1 goes on. Older checkpoints go.

        Args:
            run_id: of the run.
            k: the episode.
            facts: what it came to.
            checkpoint: the state after it.
            taus: what it executed and imagined, each with what a person is shown of it, if nothing was asked about
                that yet: an episode that is cut off then leaves nothing, and may be another one when the run goes on.

        Raises:
            StoreError: it was finished before, in another state.
        """
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            for tau, film in taus:
                add_trajectory(connection, run_id, tau, film)
            add_episode(connection, run_id, k, facts, checkpoint)

    def episodes(self, run_id: str) -> list[tuple[int, dict[str, Any]]]:
        """Number k and the facts of each finished episode, in order."""
        query = sa.select(episodes.c.k, episodes.c.facts).where(episodes.c.run_id == run_id).order_by(episodes.c.k)
        with self._database.reading() as connection:
            return [(row.k, row.facts) for row in connection.execute(query)]

    def checkpoint(self, run_id: str) -> tuple[int, bytes] | None:
        """The last finished episode and the state after it; None before the first."""
        query = sa.select(checkpoints.c.k, checkpoints.c.blob).where(checkpoints.c.run_id == run_id)
        with self._database.reading() as connection:
            row = connection.execute(query.order_by(checkpoints.c.k.desc()).limit(1)).one_or_none()
            return None if row is None else (row.k, row.blob)

    def finish(self, run_id: str, facts: Mapping[str, Any], policy: bytes) -> None:
        """Keep a run's summary and its policy.

        Raises:
            StoreError: it was finished before, with another policy.
        """
        with self._database.writing() as connection:
            lock_run(connection, run_id, self.name)
            add_final(connection, run_id, facts, policy)

    def final(self, run_id: str) -> dict[str, Any] | None:
        """The summary of a finished run; None while it is not."""
        with self._database.reading() as connection:
            return connection.execute(sa.select(finals.c.facts).where(finals.c.run_id == run_id)).scalar()

    def policy(self, run_id: str) -> bytes | None:
        """The policy of a finished run; None while it is not."""
        with self._database.reading() as connection:
            return connection.execute(sa.select(finals.c.policy).where(finals.c.run_id == run_id)).scalar()
