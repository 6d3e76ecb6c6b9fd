"""`hiprl resume`."""

from __future__ import annotations

from hiprl.cli import teaching, training
from hiprl.cli.commands import Facts, Resume
from hiprl.session import refuse_finished
from hiprl.store.rows import PEOPLE
from hiprl.store.store import open_store


def resume(command: Resume) -> Facts:
    """Goes on with a run that was stopped, whoever answers; gives its summary."""
    with open_store(command.store, create=False) as store:
        row = store.find_run(command.run)
        refuse_finished(store, row.id)
        return (teaching if row.spec["judge"] == PEOPLE else training).resume(store, row, command)
