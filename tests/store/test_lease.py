from __future__ import annotations

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

from hiprl.errors import HiprlError, InputError, StoreError
from hiprl.store.lease import Owner
from hiprl.store.store import Store
from tests.store import writer

ELSEWHERE = Owner("another-host", 12345)


def test_a_second_trainer_is_told_who_holds_the_run(store: Store, run_id: str):
    with (
        store.lease(run_id, owner=ELSEWHERE) as lease,
        pytest.raises(InputError, match=r"process 12345 on another-host.* UTC; .* one trainer .* Wait until"),
        store.lease(run_id),
    ):
        pass
    with pytest.raises(StoreError, match="another trainer has taken over"):
        lease.renew()


def test_a_lease_is_free_again_at_its_end_even_after_an_error(store: Store, run_id: str):
    with pytest.raises(ZeroDivisionError), store.lease(run_id):
        raise ZeroDivisionError
    with store.lease(run_id) as lease:
        lease.renew()


def test_one_process_cannot_hold_a_run_twice(store: Store, run_id: str):
    with store.lease(run_id), pytest.raises(InputError, match="is being trained"), store.lease(run_id):
        pass


def test_each_run_has_its_own_lease(store: Store, run_id: str):
    with store.lease(run_id), store.lease(store.add_run("Ant-v5", 3, {}, {})) as lease:
        lease.renew()


def test_a_trainer_that_died_here_is_replaced_at_once(store: Store, run_id: str):
    ended = subprocess.Popen(["true"])
    ended.wait()
    dead = Owner(Owner.here().host, ended.pid)
    with store.lease(run_id, owner=dead, seconds=900.0) as old, store.lease(run_id) as new:
        new.renew()
        with pytest.raises(StoreError, match=r"silent for 900 s; a run has one trainer .* Let the other"):
            old.renew()


def test_an_earlier_process_of_the_same_number_is_replaced_at_once(
    store: Store, run_id: str, monkeypatch: pytest.MonkeyPatch
):
    with store.lease(run_id):
        monkeypatch.setattr("hiprl.store.lease._PROCESS", "restarted")
        with store.lease(run_id) as lease:
            lease.renew()


def test_a_silent_trainer_elsewhere_is_replaced_when_its_lease_ends(
    store: Store, run_id: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("hiprl.store.lease.threading.Thread.start", lambda _: None)
    monkeypatch.setattr("hiprl.store.lease.threading.Thread.join", lambda _: None)
    with store.lease(run_id, owner=ELSEWHERE, seconds=1.0):
        with pytest.raises(InputError, match="is being trained"), store.lease(run_id):
            pass
        time.sleep(1.1)
        with store.lease(run_id) as lease:
            lease.renew()


def test_a_lease_is_renewed_while_its_holder_is_busy(store: Store, run_id: str):
    with store.lease(run_id, owner=ELSEWHERE, seconds=1.5):
        time.sleep(2.0)
        with pytest.raises(InputError, match="is being trained"), store.lease(run_id):
            pass


def test_of_many_that_want_a_run_one_gets_it(store: Store):
    start, end = Barrier(5, timeout=60), Barrier(5, timeout=60)

    def attempt(run_id: str) -> str:
        start.wait()
        try:
            with store.lease(run_id):
                end.wait()
                return "held"
        except HiprlError as error:
            end.wait()
            return type(error).__name__

    with ThreadPoolExecutor(5) as pool:
        for _ in range(5):
            run_id = store.add_run("Ant-v5", 3, {}, {})
            assert sorted(pool.map(attempt, [run_id] * 5)) == ["InputError"] * 4 + ["held"]


def test_a_killed_process_leaves_its_run_to_the_next(made: str, store: Store, run_id: str):
    with subprocess.Popen([sys.executable, writer.__file__, made, run_id], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(InputError, match=f"by process {process.pid} on"), store.lease(run_id):
            pass
        process.send_signal(signal.SIGKILL)
    with store.lease(run_id) as lease:
        lease.renew()


def test_it_is_seen_whether_a_trainer_lives(store: Store, run_id: str):
    ended = subprocess.Popen(["true"])
    ended.wait()
    assert not store.trained(run_id)
    with store.lease(run_id):
        assert store.trained(run_id) and not store.trained(store.add_run("Ant-v5", 3, {}, {}))
    assert not store.trained(run_id)
    with store.lease(run_id, owner=ELSEWHERE, seconds=900.0):
        assert store.trained(run_id)  # of other machines nothing is known
    with store.lease(run_id, owner=ELSEWHERE, seconds=0.0):
        assert not store.trained(run_id)  # silent for too long
    with store.lease(run_id, owner=Owner(Owner.here().host, ended.pid), seconds=900.0):
        assert not store.trained(run_id)  # killed
