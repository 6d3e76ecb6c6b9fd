from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext

from hiprl.data.answer import CANNOT_TELL, number, ranking
from hiprl.errors import StoreError
from hiprl.store import migrate, schema
from hiprl.store.engine import connect
from hiprl.store.rows import ClipRow
from hiprl.store.store import Store, open_store
from tests.store.writer import checkpoint, trajectory

GS = [0.1, 1 / 3, -1e300, 5e-324, 0.0, 7.0]
MOMENT = datetime(2026, 3, 4, 5, 6, 7, 891011, UTC)
NEXT = """
from alembic import op
import sqlalchemy as sa

revision, down_revision, branch_labels, depends_on = "9998", "{head}", None, None


def upgrade():
    with op.batch_alter_table("runs") as runs:
        runs.add_column(sa.Column("note", sa.Text))
    op.create_table("extras", sa.Column("id", sa.Integer, primary_key=True))
    {then}
"""


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Make this hiprl one that is a revision ahead."""

    def to(then: str) -> None:
        folder = tmp_path / "migrations"
        shutil.copytree(migrate._MIGRATIONS, folder)
        (folder / "versions" / "9998_next.py").write_text(NEXT.format(head=schema.HEAD, then=then))
        monkeypatch.setattr(migrate, "_MIGRATIONS", folder)
        monkeypatch.setattr(migrate, "HEAD", "9998")

    return to


def revision_and_tables(where: str) -> tuple[str, set[str]]:
    database = connect(where, create=False, busy_seconds=1.0)
    with database.reading() as connection:
        revision = connection.exec_driver_sql(f"SELECT version_num FROM {schema.VERSION_TABLE}").scalar_one()
        tables = set(sa.inspect(connection).get_table_names())
    database.engine.dispose()
    return revision, tables


def test_the_migrations_lead_to_the_tables_of_the_schema(store: Store):
    with store._database.reading() as connection:
        options = {"version_table": schema.VERSION_TABLE, "compare_type": True}
        context = MigrationContext.configure(connection, opts=options)
        assert compare_metadata(context, schema.metadata) == []
        assert context.get_current_revision() == schema.HEAD


def test_an_older_store_is_brought_up_to_date_with_all_it_holds(where: str, release):
    with open_store(where) as store:
        before = store.run(store.add_run("Ant-v5", 3, {"π": 1}, {}))
    release("pass")
    with open_store(where, create=False) as store, store._database.reading() as connection:
        assert connection.exec_driver_sql("SELECT id, note FROM runs").all() == [(before.id, None)]
    assert revision_and_tables(where)[0] == "9998"


def fill_at_0001(where: str) -> None:
    """Make a store as the first hiprl did, with all that it could hold."""
    database = connect(where, create=True, busy_seconds=1.0)
    config = Config()
    config.set_main_option("script_location", str(migrate._MIGRATIONS).replace("%", "%%"))
    with database.writing() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0001")

        def insert(table: str, **row: object) -> None:
            names = ", ".join(row)
            values = ", ".join(f":{name}" for name in row)
            connection.execute(sa.text(f"INSERT INTO {table} ({names}) VALUES ({values})"), row)

        moment = MOMENT if "://" in where else MOMENT.strftime("%Y-%m-%d %H:%M:%S.%f")
        insert("runs", id="ant-1", created_at=moment, env="Ant-v5", seed=2**40, spec='{"π": 1}', versions="{}")
        insert("leases", run_id="ant-1", host="here", pid=1, token="t", expires_at=moment)
        for n in range(4):
            row = trajectory(n).values()
            assert row.pop("imagined") is False  # which this store did not know of
            insert("trajectories", run_id="ant-1", **row)
        # Question 1 has no answer, 2 has one, 3 has the others.
        for k in (1, 2, 3):
            insert("questions", run_id="ant-1", k=k, first=k, second=k - 1, created_at=moment)
        for i, g in enumerate(GS):
            rest = {"judge": f"judge {i}", "swapped": i % 2 == 0, "created_at": moment}
            insert("answers", question_id=3 if i else 2, g=g, **rest)
        insert("episodes", run_id="ant-1", k=1, facts='{"return": 0.5}', created_at=moment)
        insert("checkpoints", run_id="ant-1", k=1, blob=checkpoint(1), created_at=moment)
        insert("finals", run_id="ant-1", facts='{"mean": 2.5}', policy=b"\x00\xff", created_at=moment)
    database.engine.dispose()
    assert revision_and_tables(where)[0] == "0001"


def test_a_store_of_0001_keeps_its_questions_as_pairs_and_its_answers_as_numbers(where: str):
    fill_at_0001(where)
    with open_store(where, create=False) as store:
        questions = store.questions()
        assert [(row.id, row.run_id, row.k, row.first, row.second) for row in questions] == [
            (k, "ant-1", k, k, k - 1) for k in (1, 2, 3)
        ]
        assert [row.clips for row in questions] == [(ClipRow(k), ClipRow(k - 1)) for k in (1, 2, 3)]
        assert [row.answer for row in questions] == [None, number(GS[0]), number(GS[-1])]
        rows = store.answers("ant-1")
        assert [(row.k, row.answer, row.g) for row in rows] == [(3 if i else 2, number(g), g) for i, g in enumerate(GS)]
        assert [(row.judge, row.swapped) for row in rows] == [(f"judge {i}", i % 2 == 0) for i in range(len(GS))]
        assert {row.created_at for row in [*questions, *rows, *store.runs()]} == {MOMENT}
        with store._database.reading() as connection:
            assert connection.exec_driver_sql("SELECT g FROM answers ORDER BY id").scalars().all() == GS
    assert revision_and_tables(where)[0] == schema.HEAD


def test_a_store_of_0001_keeps_all_else_that_it_holds(where: str):
    fill_at_0001(where)
    with open_store(where, create=False) as store:
        run = store.run("ant-1")
        assert (run.env, run.seed, run.spec, run.versions) == ("Ant-v5", 2**40, {"π": 1}, {})
        assert [row.differs_from(trajectory(row.number)) for row in store.trajectories("ant-1")] == [None] * 4
        assert store.episodes("ant-1") == [(1, {"return": 0.5})]
        assert store.checkpoint("ant-1") == (1, checkpoint(1))
        assert (store.final("ant-1"), store.policy("ant-1")) == ({"mean": 2.5}, b"\x00\xff")
        with store._database.reading() as connection:
            assert connection.exec_driver_sql("SELECT host, pid, token FROM leases").all() == [("here", 1, "t")]


def test_a_store_of_0001_has_the_tables_of_the_schema_afterwards(where: str):
    fill_at_0001(where)
    with open_store(where, create=False) as store:
        test_the_migrations_lead_to_the_tables_of_the_schema(store)
        for table in ("answers", "questions"):
            with store._database.writing() as connection:
                orphan = sa.insert(schema.metadata.tables[table])
                rest = {"judge": "", "swapped": False, "said": {}, "question_id": 99, "created_at": MOMENT}
                if table == "questions":
                    rest = {"run_id": "ant-1", "k": 99, "first": 99, "second": 0, "clips": [], "created_at": MOMENT}
                with pytest.raises(sa.exc.IntegrityError, match=r"(?i)foreign key"), connection.begin_nested():
                    connection.execute(orphan.values(rest))
        assert len(store.answers("ant-1")) == len(GS)


def test_a_run_of_0001_goes_on(where: str):
    fill_at_0001(where)
    with open_store(where, create=False) as store:
        assert store.ask("ant-1", 1, [ClipRow(1), ClipRow(0)]) == 1
        with pytest.raises(StoreError, match=r"it is about \(1, 0\) and \(1, 0\[2:\]\)"):
            store.ask("ant-1", 1, [ClipRow(1), ClipRow(0, 2)])
        store.answer("ant-1", 3, CANNOT_TELL, "Ada")  # newer than all that was there
        asked = store.open_question("ant-1", 4, [trajectory(4)], [ClipRow(4, 2, 3), ClipRow(0), ClipRow(4)])
        assert asked == 4
        store.answer("ant-1", 4, ranking((2, 0, 1)), "Ada")
        assert [row.answer for row in store.questions()] == [None, number(GS[0]), CANNOT_TELL, ranking((2, 0, 1))]
        assert [row.k for row in store.questions(unanswered=True)] == [1]


def test_an_old_hiprl_that_still_writes_to_a_migrated_store_is_refused(where: str):
    fill_at_0001(where)
    with open_store(where, create=False) as store:
        columns = "questions (run_id, k, first, second, created_at) VALUES ('ant-1', 9, 1, 0"
        with pytest.raises(StoreError, match=r"(?i)not.null"), store._database.writing() as connection:
            connection.exec_driver_sql(f"INSERT INTO {columns}, '{MOMENT}')")
        assert len(store.questions()) == 3


def test_a_migration_that_fails_leaves_the_old_store_whole(where: str, release):
    with open_store(where) as store:
        run_id = store.add_run("Ant-v5", 3, {}, {})
        tables = revision_and_tables(where)
        with pytest.MonkeyPatch.context():
            release('op.execute("INSERT INTO no_such_table VALUES (1)")')
            with pytest.raises(StoreError, match="refused what was asked"):
                open_store(where)
        assert revision_and_tables(where) == tables
        assert store.run(run_id).seed == 3


def test_a_newer_store_is_refused_and_left_alone(where: str):
    with open_store(where) as store, store._database.writing() as connection:
        connection.exec_driver_sql(f"UPDATE {schema.VERSION_TABLE} SET version_num = '9999'")
    with pytest.raises(StoreError, match=r"newer hiprl \(its revision is 9999\); this one reads .* Upgrade hiprl"):
        open_store(where)
    assert revision_and_tables(where)[0] == "9999"


def test_a_database_of_another_program_is_refused_and_left_alone(where: str, tmp_path: Path):
    database = connect(where, create=True, busy_seconds=1.0)
    with database.writing() as connection:
        connection.exec_driver_sql("CREATE TABLE bookmarks (id INTEGER PRIMARY KEY)")
    database.engine.dispose()
    before = (tmp_path / "runs.db").read_bytes() if "://" not in where else None
    with pytest.raises(StoreError, match=r"another program \(it has a table bookmarks\); .* Name another"):
        open_store(where)
    if before is not None:
        assert (tmp_path / "runs.db").read_bytes() == before
        assert os.listdir(tmp_path) == ["runs.db"]


def test_processes_that_make_one_store_at_once_all_get_it(where: str):
    code = "import sys; from hiprl.store.store import open_store; s = open_store(sys.argv[1]);"
    code += "s.add_run('Ant-v5', 1, {}, {}); s.close()"
    makers = [subprocess.Popen([sys.executable, "-c", code, where]) for _ in range(2)]
    assert [maker.wait() for maker in makers] == [0, 0]
    with open_store(where, create=False) as store:
        assert len(store.runs()) == 2


@pytest.mark.parametrize("moment", [0.0, 0.02, 0.05])
def test_a_kill_while_a_store_is_made_leaves_none_or_a_whole_one(tmp_path: Path, moment: float):
    path = tmp_path / "runs.db"
    code = (
        "import sys, alembic.command; from hiprl.store.store import open_store; print(1, flush=True);"
        "open_store(sys.argv[1]); import time; time.sleep(9)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(moment)
        process.send_signal(signal.SIGKILL)
    if path.exists():
        with closing(sqlite3.connect(path)) as connection:
            tables = connection.execute("SELECT count(*) FROM sqlite_master WHERE type = 'table'").fetchone()[0]
        assert tables in (0, len(schema.metadata.tables) + 1)
    with open_store(path) as store:
        assert store.runs() == []
