from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext

from hiprl.errors import StoreError
from hiprl.store import migrate, schema
from hiprl.store.engine import connect
from hiprl.store.store import Store, open_store

NEXT = """
from alembic import op
import sqlalchemy as sa

revision, down_revision, branch_labels, depends_on = "0002", "0001", None, None


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
        (folder / "versions" / "0002_next.py").write_text(NEXT.format(then=then))
        monkeypatch.setattr(migrate, "_MIGRATIONS", folder)
        monkeypatch.setattr(migrate, "HEAD", "0002")

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
    assert revision_and_tables(where)[0] == "0002"


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
