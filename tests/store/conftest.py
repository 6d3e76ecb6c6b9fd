"""A store in each database that hiprl supports."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hiprl.store.store import Store, open_store

DATABASES = ["sqlite", "postgresql"]


@pytest.fixture(params=DATABASES)
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Path or address of a store that is not made yet."""
    if request.param == "sqlite":
        return str(tmp_path / "runs.db")
    return request.getfixturevalue("postgres_url")


@pytest.fixture(scope="session")
def new_file(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], str]:
    """Puts a new store at a path, faster than making one each time."""
    path = tmp_path_factory.mktemp("new") / "runs.db"
    open_store(path).close()
    return lambda copy: str(shutil.copy(path, copy))


@pytest.fixture(scope="session")
def emptied_database(postgres_folder: Path) -> Callable[[], str]:
    """Empties one PostgreSQL store again and again, faster than making one each time."""
    psycopg = pytest.importorskip("psycopg", reason="psycopg is not here (pip install 'hiprl[postgres]')")
    name = f"emptied_{secrets.token_hex(4)}"  # folders of tests that share this each have one
    with psycopg.connect(host=str(postgres_folder), user="hiprl", dbname="postgres", autocommit=True) as server:
        server.execute(f"CREATE DATABASE {name}")
    url = f"postgresql+psycopg://hiprl@/{name}?host={postgres_folder}"
    open_store(url).close()

    def empty() -> str:
        with psycopg.connect(host=str(postgres_folder), user="hiprl", dbname=name) as connection:
            connection.execute(
                "DELETE FROM claims; DELETE FROM answers; DELETE FROM questions; DELETE FROM trajectories"
            )
            connection.execute("DELETE FROM leases; DELETE FROM checkpoints; DELETE FROM episodes")
            connection.execute("DELETE FROM finals; DELETE FROM scenes; DELETE FROM goals")
            connection.execute("DELETE FROM enough; DELETE FROM runs; DELETE FROM pages")
        return url

    return empty


@pytest.fixture(params=DATABASES)
def made(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Path or address of a store without any run."""
    if request.param == "sqlite":
        return request.getfixturevalue("new_file")(tmp_path / "runs.db")
    return request.getfixturevalue("emptied_database")()


@pytest.fixture
def store(made: str) -> Iterator[Store]:
    with open_store(made) as opened:
        yield opened


@pytest.fixture
def run_id(store: Store) -> str:
    return store.add_run("Hopper-v5", 7, {"preset": "paper"}, {"hiprl": "0.1.0"})
