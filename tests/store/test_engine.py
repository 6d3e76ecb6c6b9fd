from __future__ import annotations

import os
import re
import sqlite3
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from hiprl.errors import InputError, StoreError
from hiprl.store.store import open_store
from tests.store.writer import checkpoint

NOBODY = 65534


def made_at(path: Path) -> str:
    """A store with one run; gives the run's id."""
    with open_store(path) as store:
        return store.add_run("Ant-v5", 3, {}, {})


@contextmanager
def without_rights() -> Iterator[None]:
    """For root nothing is read-only: be somebody else."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def folder() -> Iterator[Path]:
    """One that root can give away: pytest's lie in a folder that is closed to others."""
    with tempfile.TemporaryDirectory(prefix="hiprl-store-") as name:
        path = Path(name)
        path.chmod(0o755)
        yield path
        path.chmod(0o755)


# Wrong places


def test_a_folder_that_does_not_exist_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"no folder .*nowhere; the store's folder must exist\. Create it"):
        open_store(tmp_path / "nowhere" / "runs.db")


def test_a_folder_is_not_a_store(tmp_path: Path):
    with pytest.raises(InputError, match=r"is a folder; a store is a file\. Name a file in it"):
        open_store(tmp_path)


@pytest.mark.parametrize("where", ["", ":memory:", "sqlite://"])
def test_a_store_needs_a_file(where: str):
    with pytest.raises(InputError, match=r"got no file .*; it lives in a file.* Name one"):
        open_store(where)


def test_without_create_nothing_is_made(tmp_path: Path):
    path = tmp_path / "runs.db"
    with pytest.raises(InputError, match=r"there is no store .*runs\.db; .* is needed\. Go to the folder"):
        open_store(path, create=False)
    assert not path.exists()
    path.touch()
    with pytest.raises(InputError, match=r"runs\.db is empty; .* is needed\. Check the path"):
        open_store(path, create=False)


@pytest.mark.parametrize("name", ["50%.db", "what?.db", "a#b&c=d.db", "ünï cödé.db"])
def test_any_file_name_will_do(tmp_path: Path, name: str):
    run_id = made_at(tmp_path / name)
    assert (tmp_path / name).is_file()
    with open_store(str(tmp_path / name), create=False) as store:
        assert store.run(run_id).id == run_id


def test_an_sqlite_address_and_a_path_are_the_same_store(tmp_path: Path):
    run_id = made_at(tmp_path / "runs.db")
    with open_store(f"sqlite:///{tmp_path}/runs.db", create=False) as store:
        assert store.run(run_id).id == run_id


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("mysql://me:secret@host/db", r"address for mysql; .* is needed\. Name one"),
        (
            "postgresql://me:secret@host:port/db",
            r"cannot read the store's address; .* is needed\. Check its parts",
        ),
    ],
)
def test_an_address_of_another_kind_is_refused_without_its_password(address: str, message: str):
    with pytest.raises(InputError, match=message) as caught:
        open_store(address)
    assert "secret" not in str(caught.value)


# Trouble with SQLite


def test_a_file_that_is_no_database_is_refused(tmp_path: Path):
    path = tmp_path / "notes.txt"
    path.write_text("Buy milk. " * 500)
    with pytest.raises(StoreError, match=r"notes\.txt is no SQLite database; .* Name another file"):
        open_store(path)
    assert path.read_text() == "Buy milk. " * 500


def test_a_damaged_store_is_reported(tmp_path: Path):
    path = tmp_path / "runs.db"
    run_id = made_at(path)
    with open_store(path) as store:
        for k in range(9):
            store.finish_episode(run_id, k, {}, checkpoint(k))
    data = path.read_bytes()
    path.write_bytes(data[:4096] + b"\xa5" * (len(data) - 4096))
    with (
        pytest.raises(StoreError, match=r"is damaged; a whole SQLite file is needed\. Take it from a backup"),
        open_store(path) as store,
    ):
        store.runs()


def test_a_locked_store_is_reported_after_the_wait(tmp_path: Path):
    path = tmp_path / "runs.db"
    run_id = made_at(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with open_store(path, busy_seconds=0.05) as store:
            assert store.run(run_id).seed == 3  # readers go on
            with pytest.raises(StoreError, match=r"is locked by another .* must be free to go on\. Close"):
                store.finish(run_id, {}, b"")
            other.execute("ROLLBACK")
            store.finish(run_id, {}, b"")


def test_a_read_only_file_can_be_read_and_not_written(folder: Path):
    path = folder / "runs.db"
    run_id = made_at(path)
    folder.chmod(0o777)
    path.chmod(0o444)
    with without_rights(), open_store(path) as store:
        assert store.run(run_id).seed == 3
        with pytest.raises(StoreError, match=r"is read-only; the store must be writable.* Change the permissions"):
            store.finish(run_id, {}, b"")


def test_a_read_only_folder_is_refused(folder: Path):
    made_at(folder / "runs.db")
    (folder / "runs.db").chmod(0o666)
    folder.chmod(0o555)
    message = r"(is read-only|cannot be opened); .* must be .*writable.* Change the permissions"
    for name in ("runs.db", "new.db"):
        with without_rights(), pytest.raises(StoreError, match=message), open_store(folder / name) as store:
            store.add_run("Ant-v5", 1, {}, {})


def test_a_full_disk_is_reported_and_what_was_stored_is_safe(tmp_path: Path):
    path = tmp_path / "runs.db"
    run_id = made_at(path)
    with open_store(path) as store:
        store.finish_episode(run_id, 1, {}, checkpoint(1))
        with store._database.reading() as connection:
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
            connection.exec_driver_sql(f"PRAGMA max_page_count = {pages + 2}")
        message = r"the disk is full; nothing of the last step was stored.* Free some space"
        with pytest.raises(StoreError, match=message):
            store.finish_episode(run_id, 2, {}, checkpoint(2))
        assert [k for k, _ in store.episodes(run_id)] == [1]
        assert store.checkpoint(run_id) == (1, checkpoint(1))


def test_a_store_survives_a_power_cut_and_lets_readers_in_while_it_writes(tmp_path: Path):
    made_at(tmp_path / "runs.db")
    with open_store(tmp_path / "runs.db") as store, store._database.reading() as connection:
        settings = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar_one()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        }
    assert settings == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}


# Trouble with PostgreSQL


def test_a_server_out_of_reach_is_reported_without_its_password():
    address = "postgresql+psycopg://me:secret@127.0.0.1:1/runs"
    with pytest.raises(StoreError, match=r"is out of reach; a running server is needed\. Start it") as caught:
        open_store(address)
    assert "secret" not in str(caught.value)


def test_a_database_that_does_not_exist_is_reported(postgres_url: str):
    missing = re.sub(r"/test_\d+", "/nobody_made_it", postgres_url)
    with pytest.raises(StoreError, match=r"has no such database; one must exist.* Create it with createdb"):
        open_store(missing)


def test_a_connection_lost_between_two_steps_is_made_again(postgres_url: str):
    with open_store(postgres_url) as store, open_store(postgres_url) as other:
        run_id = store.add_run("Ant-v5", 3, {}, {})
        cut = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()"
        with other._database.writing() as connection:
            connection.exec_driver_sql(cut + " AND datname = current_database()")
        assert store.run(run_id).seed == 3


def test_a_connection_lost_within_a_step_is_reported(postgres_url: str):
    with (
        open_store(postgres_url) as store,
        pytest.raises(StoreError, match=r"a running server is needed\. Start it"),
        store._database.writing() as connection,
    ):
        connection.exec_driver_sql("SELECT pg_terminate_backend(pg_backend_pid())")


def test_a_lock_held_for_long_is_reported(postgres_url: str):
    with open_store(postgres_url) as store, open_store(postgres_url, busy_seconds=0.05) as other:
        run_id = store.add_run("Ant-v5", 3, {}, {})
        with store._database.writing() as connection:
            connection.exec_driver_sql("LOCK TABLE finals")
            with pytest.raises(StoreError, match=r"is locked by another program .*; it must be free"):
                other.finish(run_id, {}, b"")


def test_a_missing_driver_is_reported(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(StoreError, match=r"driver is missing .*; psycopg is needed\. Install it: pip install"):
        open_store("postgresql+psycopg://me@host/db")
