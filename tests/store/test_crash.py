from __future__ import annotations

import random
import signal
import subprocess
import sys
import time

import pytest

from hiprl.store.store import open_store
from tests.store import writer

MOMENTS = [random.Random(seed).uniform(0, 0.15) for seed in range(3)]


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_kill_leaves_whole_episodes_and_the_run_goes_on(made: str, moment: float):
    with open_store(made) as store:
        run_id = store.add_run("Swimmer-v5", 3, {}, {})
    with subprocess.Popen([sys.executable, writer.__file__, made, run_id], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(moment)
        process.send_signal(signal.SIGKILL)
        reported = 1 + len(process.stdout.read().split())
    # A database may still commit what a writer sent last before it died: who has the lease comes after that.
    with open_store(made, create=False) as store, store.lease(run_id):
        done = [k for k, _ in store.episodes(run_id)]
        assert done == list(range(1, len(done) + 1))
        assert len(done) >= reported  # what was reported as done is there
        assert store.checkpoint(run_id) == (done[-1], writer.checkpoint(done[-1]))
        assert set(done) <= {row.k for row in store.answers(run_id)}
        numbers = [row.number for row in store.trajectories(run_id)]
        asked = [row.k for row in store.questions(run_id)]
        assert numbers[2:] == [k + 1 for k in asked]  # a question and its trajectory come together
        assert len(asked) - len(done) in (0, 1)

        writer.go_on(store, run_id, episodes=3)
        whole = len(done) + 3
        assert store.episodes(run_id) == [(k, {"k": k, "return": k / 7}) for k in range(1, whole + 1)]
        assert [(row.k, row.g) for row in store.answers(run_id)] == [(k, k / 3) for k in range(1, whole + 1)]
        for row in store.trajectories(run_id):
            assert row.differs_from(writer.trajectory(row.number)) is None
