import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hiprl.feedback.judges import exact
from hiprl.session import RunSpec, carry_on, start
from hiprl.store.store import open_store
from hiprl.world.build import world_from
from tests.whole.tasks import TINY
from tests.whole.test_resume import SPEC, remains, uninterrupted  # noqa: F401

PROGRAM = Path(__file__).with_name("train_tiny.py")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_a_run_that_was_killed_and_resumed_equals_one_that_was_not(seed, tmp_path, uninterrupted):  # noqa: F811
    """Kill -9 some time after a random episode of a process, then go on here."""
    rng = random.Random(seed)
    where = tmp_path / "runs.db"
    with open_store(where) as store:
        run_id = start(store, world_from("linear"), SPEC)
    process = subprocess.Popen([sys.executable, PROGRAM, where, run_id], stdout=subprocess.PIPE, text=True)
    try:
        for _ in range(rng.randrange(TINY.comparisons)):
            assert process.stdout.readline().strip()  # an episode is finished
        time.sleep(rng.uniform(0, 0.3))  # anywhere in the next one
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    with open_store(where) as store:
        if store.final(run_id) is None:
            carry_on(store, run_id, world_from("linear"), exact)
        assert remains(store, run_id) == uninterrupted


def test_the_spec_of_the_killed_run_is_the_one_compared_with():
    assert isinstance(SPEC, RunSpec) and SPEC.config is TINY
