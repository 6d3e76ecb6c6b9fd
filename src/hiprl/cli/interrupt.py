"""Ctrl-C that works at once, also while a compiled program runs.

Python sees a signal when it next runs a line of its own, and a search can be half a minute of compiled code. A run is
in the store whatever happens to its trainer, so nothing is lost if the process ends instead of waiting.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator

INTERRUPTED = 130  # the exit status of what Ctrl-C stopped: 128 and the number of the signal
PATIENCE = 1.0  # seconds for Python to stop by itself


@contextlib.contextmanager
def stoppable(farewell: Callable[[], None], *, patience: float = PATIENCE) -> Iterator[None]:
    """Within it, Ctrl-C raises KeyboardInterrupt, or ends the process after `farewell` if that comes too late.

    Only the main thread can have it; in others, and where Ctrl-C is ignored, nothing changes.
    """
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or usual is not signal.default_int_handler:
        yield
        return
    over = threading.Event()
    ear, mouth = socket.socketpair()
    mouth.setblocking(False)

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # once is enough; the second would break what the first ends
        raise KeyboardInterrupt

    def listen() -> None:
        while heard := ear.recv(1):
            if heard[0] == signal.SIGINT and not over.wait(patience):
                try:
                    farewell()
                finally:
                    os._exit(INTERRUPTED)

    listener = threading.Thread(target=listen, name="Ctrl-C", daemon=True)
    listener.start()
    signal.signal(signal.SIGINT, stop)
    before = signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        signal.signal(signal.SIGINT, usual)
        mouth.close()
        listener.join()
        ear.close()
