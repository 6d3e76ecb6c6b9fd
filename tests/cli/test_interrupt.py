from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import pytest

from hiprl.cli.interrupt import stoppable

PROGRAM = """
import sys, time
from hiprl.cli.interrupt import stoppable
try:
    with stoppable(lambda: print("farewell", flush=True), patience=1.0):
        print("ready", flush=True)
        {work}
except KeyboardInterrupt:
    print("interrupted", flush=True)
    time.sleep({after})
    print("went on", flush=True)
"""
IN_PYTHON = "time.sleep(60)"
IN_COMPILED_CODE = "import hashlib; hashlib.pbkdf2_hmac('sha256', b'a', b'b', 2_000_000_000)"


def stopped(work: str, *, after: float = 0.0) -> tuple[list[str], int, float]:
    """What a program printed that got Ctrl-C while it worked, its exit status, and how long it took to end."""
    command = [sys.executable, "-c", PROGRAM.format(work=work, after=after)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        time.sleep(0.2)
        program.send_signal(signal.SIGINT)
        began = time.monotonic()
        said = program.stdout.read().split("\n")[:-1]
        return said, program.wait(), time.monotonic() - began


def test_python_code_is_interrupted_as_ever() -> None:
    assert stopped(IN_PYTHON)[:2] == (["interrupted", "went on"], 0)


def test_what_follows_may_take_longer_than_the_patience() -> None:
    assert stopped(IN_PYTHON, after=1.3)[0] == ["interrupted", "went on"]


def test_compiled_code_ends_with_the_process() -> None:
    said, status, seconds = stopped(IN_COMPILED_CODE)
    assert (said, status) == (["farewell"], 130)
    assert seconds < 20


def test_signals_are_as_before_when_it_is_over() -> None:
    before = signal.getsignal(signal.SIGINT)
    with stoppable(lambda: None):
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt), stoppable(lambda: None):
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_changes_no_signals() -> None:
    seen: list[object] = []

    def work() -> None:
        with stoppable(lambda: None):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]
