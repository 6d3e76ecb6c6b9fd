"""A person at the page teaches a pendulum to stand, with `hiprl teach` as anybody types it."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.clicker import CHROMIUM
from benchmarks.taught import WISHES, taught
from hiprl.store.store import open_store


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is here (Debian: apt-get install chromium)")
def test_a_pendulum_is_taught_to_stand(tmp_path: Path):
    path = str(tmp_path / "taught.db")
    found = taught(WISHES["balance"], answers=16, seed=0, store=path)
    with open_store(path) as store:
        run_id = store.runs()[0].id
        random = [tau.length for tau in store.trajectories(run_id) if tau.kind == "random"]
        assert len(store.answers(run_id)) == found["answers"] == 16
        assert store.goal(run_id) == WISHES["balance"].words
    assert found["return"] > 3 * max(random)  # a step upright is worth 1, which nobody was told
