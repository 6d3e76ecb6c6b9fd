"""Makes a new store, brings an old one up to date, and refuses what is neither."""

from __future__ import annotations

from pathlib import Path

import sqlalchemy as sa

from hiprl.errors import InputError, StoreError
from hiprl.store.engine import Database
from hiprl.store.schema import HEAD, VERSION_TABLE

_MIGRATIONS = Path(__file__).parent / "migrations"
_LOCK = 0x68697072  # PostgreSQL locks by number; this one spells "hipr"


def bring_up_to_date(database: Database, *, create: bool) -> None:
    """Leave the database at revision HEAD, in one transaction.

    Raises:
        InputError: it is empty, and `create` is False.
        StoreError: it holds other tables, was made by a newer hiprl, or cannot be used.
    """
    with database.reading() as connection:
        found = _revision(connection, database.name)
    if found is None and not create:
        raise InputError(f"{database.name} is empty; a store made by an earlier run is needed. Check the path.")
    if found != HEAD:
        with database.writing() as connection:
            if connection.dialect.name == "postgresql":
                connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK)))
            found = _revision(connection, database.name)  # another process may have been first
            if found != HEAD:
                _upgrade(connection, found, database.name)
    database.use_wal()


def _revision(connection: sa.Connection, name: str) -> str | None:
    """The store's revision; None if the database is empty."""
    tables = sa.inspect(connection).get_table_names()
    if VERSION_TABLE in tables:
        return connection.execute(sa.select(sa.column("version_num")).select_from(sa.table(VERSION_TABLE))).scalar_one()
    if tables:
        raise StoreError(
            f"{name} is a database of another program (it has a table {tables[0]}); "
            "a store is empty or made by hiprl. Name another file or database."
        )
    return None


def _upgrade(connection: sa.Connection, found: str | None, name: str) -> None:
    from alembic import command  # slow to import, and seldom needed
    from alembic.config import Config
    from alembic.script import ScriptDirectory

    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = connection
    known = [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()]
    if found is not None and found not in known:
        raise StoreError(
            f"{name} was made by a newer hiprl (its revision is {found}); this one reads up to revision "
            f"{HEAD}. Upgrade hiprl: pip install --upgrade hiprl"
        )
    command.upgrade(config, "head")
