"""A connection to SQLite or PostgreSQL whose transactions report their errors in our words."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError

from hiprl.errors import InputError, StoreError

_SQLITE = {
    "SQLITE_NOTADB": "is no SQLite database; a store is a file that hiprl made. Name another file.",
    "SQLITE_CORRUPT": "is damaged; a whole SQLite file is needed. Take it from a backup, or name another.",
    "SQLITE_BUSY": (
        "is locked by another program that has been writing for long; the store must be free to go on. "
        "Close what has the file open (a database browser, a backup), then try again."
    ),
    "SQLITE_READONLY": (
        "is read-only; the store must be writable, file and folder. "
        "Change the permissions, or copy the file to a folder of your own."
    ),
    "SQLITE_FULL": (
        "has no room to grow: the disk is full; nothing of the last step was stored, all before it is safe. "
        "Free some space, then resume the run."
    ),
    "SQLITE_CANTOPEN": (
        "cannot be opened; the file and its folder must be readable and writable, since SQLite keeps two "
        "more files (-wal, -shm) beside it. Change the permissions, or name a file in a folder of your own."
    ),
    "SQLITE_IOERR": (
        "could not be read or written by the system; a store needs a working disk, and no network folder. "
        "Check the disk and its free space, then resume the run."
    ),
}
_SQLITE["SQLITE_PERM"] = _SQLITE["SQLITE_CANTOPEN"]
_SQLITE["SQLITE_LOCKED"] = _SQLITE["SQLITE_BUSY"]

_POSTGRES = {
    "08": "is out of reach; a running server is needed. Start it or check the network, then try again.",
    "25006": "is read-only; a store must be writable. Connect to the main server, not to a replica.",
    "28": "refuses the user or password; both must be right. Correct them in the address.",
    "3D": "has no such database; one must exist, empty or made by hiprl. Create it with createdb.",
    "42501": "denies this user the right; it must create and write tables. Grant it, or use another user.",
    "53": "is out of disk, memory or connections; the server needs room to go on. Free some, then try again.",
    "55P03": "is locked by another program that has been writing for long; it must be free. Then try again.",
    "57": "is shutting down or stopped our query; a running server is needed. Start it, then try again.",
}


class Database:
    """Where a store lies. Used through `reading` and `writing`, it raises StoreError and no other."""

    def __init__(self, engine: sa.Engine, name: str):
        self.engine = engine
        self.name = name
        """Path or address, without any password."""

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """One transaction that sees one state of the store."""
        with self._connection("BEGIN") as connection:
            if self.engine.dialect.name == "postgresql":
                connection = connection.execution_options(isolation_level="REPEATABLE READ")
            with connection.begin():
                yield connection

    @contextmanager
    def writing(self) -> Iterator[sa.Connection]:
        """One transaction, whole or not at all. SQLite's has the file for itself from its start."""
        with self._connection("BEGIN IMMEDIATE") as connection, connection.begin():
            yield connection

    def use_wal(self) -> None:
        """Let SQLite's readers and writer work side by side from now on; the file keeps the setting.

        A file that is busy or read-only stays as it is: as safe, and slower. The next opening tries again.
        """
        if self.engine.dialect.name != "sqlite":
            return
        with self._connection(None) as connection:
            if connection.exec_driver_sql("PRAGMA journal_mode").scalar_one() == "wal":
                return
            try:
                connection.exec_driver_sql("PRAGMA journal_mode = WAL")
            except DBAPIError as error:
                if not _sqlite_name(error).startswith(("SQLITE_BUSY", "SQLITE_READONLY", "SQLITE_LOCKED")):
                    raise

    @contextmanager
    def _connection(self, begin: str | None) -> Iterator[sa.Connection]:
        try:
            with self.engine.connect() as connection:
                connection.info["begin"] = begin
                yield connection
        except SQLAlchemyError as error:
            raise self._in_our_words(error) from error

    def _in_our_words(self, error: SQLAlchemyError) -> StoreError:
        said = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
        if isinstance(error, DBAPIError):
            if self.engine.dialect.name == "sqlite":
                known, code = _SQLITE, _sqlite_name(error)
            else:
                # No code: the server was never reached, or hung up.
                known, code = _POSTGRES, getattr(error.orig, "sqlstate", None) or _code_before_login(said)
            for prefix, message in known.items():
                if code.startswith(prefix):
                    return StoreError(f"the store {self.name} {message} ({said})")
        return StoreError(
            f"the store {self.name} refused what was asked ({said}); a store made by this version of hiprl "
            "is needed. If it is one, this is a bug of hiprl: report it with this message."
        )


def connect(where: str | Path, *, create: bool, busy_seconds: float) -> Database:
    """A database from a path (SQLite) or an address; nothing is read or written yet.

    Args:
        where: a file, or `postgresql+psycopg://user:password@host/database`.
        create: whether a file that does not exist is a new store.
        busy_seconds: how long to wait for other writers.

    Raises:
        InputError: there is no such file or folder, or the address cannot be read.
        StoreError: the driver for PostgreSQL is missing.
    """
    url = _url_from(where)
    if url.drivername == "sqlite":
        return _sqlite(Path(url.database or ""), create=create, busy_seconds=busy_seconds)
    return _postgres(url, busy_seconds=busy_seconds)


def _url_from(where: str | Path) -> sa.URL:
    if isinstance(where, Path) or "://" not in where:
        return sa.URL.create("sqlite", database=str(Path(where).expanduser()) if str(where) else None)
    needed = "a path or postgresql+psycopg://user:password@host/database is needed."
    try:
        url = sa.make_url(where)
    except (ArgumentError, ValueError) as error:
        raise InputError(
            f"cannot read the store's address; {needed} Check its parts; signs such as @ or / in a password "
            "are written %40 or %2F."
        ) from error
    if url.drivername in ("postgres", "postgresql"):
        url = url.set(drivername="postgresql+psycopg")
    if url.drivername not in ("sqlite", "postgresql+psycopg"):
        raise InputError(f"got a store's address for {url.drivername}; {needed} Name one, such as runs.db.")
    return url


def _sqlite(path: Path, *, create: bool, busy_seconds: float) -> Database:
    if path.name in ("", ":memory:"):
        raise InputError("got no file for the store; it lives in a file, so that a run survives. Name one: runs.db")
    if path.is_dir():
        raise InputError(f"{path} is a folder; a store is a file. Name a file in it: {path / 'runs.db'}")
    if not create and not path.exists():
        raise InputError(
            f"there is no store {path}; one made by an earlier run is needed. Go to the folder in which the run was "
            "begun, or name the store with `--store`."
        )
    if not path.parent.is_dir():
        raise InputError(
            f"there is no folder {path.parent}; the store's folder must exist. Create it, or name another."
        )
    engine = sa.create_engine(sa.URL.create("sqlite", database=str(path)), connect_args={"timeout": busy_seconds})

    @event.listens_for(engine, "connect")
    def prepare(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # else the driver begins by itself, and not before CREATE TABLE
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA synchronous = FULL")  # an answer survives a power cut, not only a kill

    @event.listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        if connection.info["begin"]:
            connection.exec_driver_sql(connection.info["begin"])

    return Database(engine, str(path))


def _postgres(url: sa.URL, *, busy_seconds: float) -> Database:
    name = url.render_as_string(hide_password=True)
    patience = {} if "connect_timeout" in url.query else {"connect_timeout": 10}
    try:
        engine = sa.create_engine(url, pool_pre_ping=True, connect_args=patience)
    except ImportError as error:
        raise StoreError(
            f"the store {name} is in PostgreSQL, and its driver is missing ({error}); psycopg is needed. "
            "Install it: pip install 'hiprl[postgres]'"
        ) from error

    @event.listens_for(engine, "connect")
    def prepare(connection: Any, _: Any) -> None:
        connection.execute(f"SET lock_timeout = {int(busy_seconds * 1000)}")
        connection.commit()

    return Database(engine, name)


def _sqlite_name(error: DBAPIError) -> str:
    return getattr(error.orig, "sqlite_errorname", "")


def _code_before_login(said: str) -> str:
    """PostgreSQL's code for an error that came without one, because it came while connecting."""
    if "does not exist" in said and "database" in said:
        return "3D000"
    return "28000" if "authentication failed" in said or "no password" in said else "08000"


def now(connection: sa.Connection) -> datetime:
    """The time by the server's clock, which all machines share; SQLite has but one machine."""
    if connection.dialect.name == "postgresql":
        return connection.execute(sa.select(sa.func.clock_timestamp())).scalar_one()
    return datetime.now(UTC)
