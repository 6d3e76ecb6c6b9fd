from __future__ import annotations

from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from hiprl.store.store import Store
from hiprl.web.access import Doors
from hiprl.web.app import app_of
from tests.store.conftest import *  # noqa: F403
from tests.web.made import a_taught_run


@pytest.fixture
def run_id(store: Store) -> str:
    return a_taught_run(store)


@pytest.fixture
def doors(store: Store) -> Doors:
    return Doors(store.secret(), "open sesame")


@pytest.fixture
def outside(store: Store, doors: Doors) -> Iterator[TestClient]:
    """A browser that has not come in."""
    with TestClient(app_of(store, doors, hosts=["testserver"]), follow_redirects=False) as client:
        yield client


@pytest.fixture
def client(outside: TestClient, doors: Doors) -> TestClient:
    """A browser that has, and sends what our scripts send."""
    assert outside.get("/enter", params={"token": doors.token}).status_code == 303
    outside.headers["X-Hiprl"] = "1"
    return outside
