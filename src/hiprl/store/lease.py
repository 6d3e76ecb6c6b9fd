"""One trainer a run: a lease that its holder renews, and that frees itself when the holder dies."""

from __future__ import annotations

import os
import secrets
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any, NamedTuple

import sqlalchemy as sa

from hiprl.errors import HiprlError, InputError, StoreError
from hiprl.store.engine import Database, now
from hiprl.store.schema import leases, runs

_PROCESS = secrets.token_hex(4)  # tells this process from an earlier one of the same number


class Owner(NamedTuple):
    """A process that trains."""

    host: str
    pid: int

    @classmethod
    def here(cls) -> Owner:
        """This process."""
        return cls(socket.gethostname(), os.getpid())


class Lease:
    """The right to train a run. A thread renews it while it is held."""

    def __init__(self, database: Database, run_id: str, token: str, seconds: float):
        self._database = database
        self._run_id = run_id
        self._token = token
        self._seconds = seconds

    def renew(self) -> None:
        """Hold it for its full time again.

        Raises:
            StoreError: another trainer has taken the run over, since this one was silent for too long.
        """
        with self._database.writing() as connection:
            until = now(connection) + timedelta(seconds=self._seconds)
            mine = (leases.c.run_id == self._run_id) & (leases.c.token == self._token)
            if connection.execute(sa.update(leases).where(mine).values(expires_at=until)).rowcount == 0:
                raise StoreError(
                    f"another trainer has taken over run {self._run_id}, as this one was silent for "
                    f"{self._seconds:g} s; a run has one trainer at a time. "
                    "Let the other one go on, or stop it and resume the run."
                )

    def release(self) -> None:
        """Let the next trainer have the run at once."""
        with self._database.writing() as connection:
            mine = (leases.c.run_id == self._run_id) & (leases.c.token == self._token)
            connection.execute(sa.delete(leases).where(mine))


@contextmanager
def hold(database: Database, run_id: str, *, owner: Owner | None, seconds: float) -> Iterator[Lease]:
    """The lease of a run that exists, renewed in the background and given back at the end.

    Raises:
        InputError: a trainer holds it that lives, as far as can be seen from here.
    """
    lease = _take(database, run_id, owner or Owner.here(), seconds)
    done = threading.Event()

    def keep() -> None:
        while not done.wait(seconds / 3):
            # A server that is away may be back in time; the holder's own renew tells when it was not.
            with suppress(HiprlError):
                lease.renew()

    heartbeat = threading.Thread(target=keep, name=f"lease of {run_id}", daemon=True)
    heartbeat.start()
    try:
        yield lease
    finally:
        done.set()
        heartbeat.join()
        with suppress(StoreError):  # it expires by itself, and what ended the run is the better message
            lease.release()


def _take(database: Database, run_id: str, owner: Owner, seconds: float) -> Lease:
    token = f"{_PROCESS}-{secrets.token_hex(8)}"
    with database.writing() as connection:
        # Locks the run's row in PostgreSQL; in SQLite the transaction has the file for itself anyway.
        connection.execute(sa.select(runs.c.id).where(runs.c.id == run_id).with_for_update())
        held = connection.execute(sa.select(leases).where(leases.c.run_id == run_id)).one_or_none()
        if held is not None:
            if _is_live(connection, held):
                raise InputError(
                    f"run {run_id} is being trained by process {held.pid} on {held.host}, which holds it "
                    f"until {held.expires_at:%Y-%m-%d %H:%M:%S} UTC; a run has one trainer at a time. "
                    "Wait until it is done, or stop that process and try again."
                )
            connection.execute(sa.delete(leases).where(leases.c.run_id == run_id))
        until = now(connection) + timedelta(seconds=seconds)
        connection.execute(
            sa.insert(leases).values(run_id=run_id, host=owner.host, pid=owner.pid, token=token, expires_at=until)
        )
    return Lease(database, run_id, token, seconds)


def is_held(connection: sa.Connection, run_id: str) -> bool:
    """Whether a trainer holds the run that lives, as far as can be seen from here."""
    held = connection.execute(sa.select(leases).where(leases.c.run_id == run_id)).one_or_none()
    return held is not None and _is_live(connection, held)


def _is_live(connection: sa.Connection, held: Any) -> bool:
    """Whether a lease has time left, and its holder is not known to be dead."""
    return held.expires_at > now(connection) and not _is_dead(Owner(held.host, held.pid), held.token)


def _is_dead(owner: Owner, token: str) -> bool:
    """The process ran on this machine and runs no more. Of other machines nothing is known."""
    if owner == Owner.here():  # a container that starts again numbers its processes as before
        return not token.startswith(_PROCESS)
    if owner.host != socket.gethostname() or sys.platform == "win32":  # there, os.kill kills whatever the signal
        return False
    try:
        os.kill(owner.pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False
    return False
