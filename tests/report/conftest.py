"""A store with a few runs that nobody executed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hiprl.store.store import Store, open_store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with open_store(tmp_path / "runs.db") as opened:
        yield opened
