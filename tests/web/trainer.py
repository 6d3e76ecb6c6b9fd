"""A trainer in a process of its own that learns next to nothing, quickly. Tests kill it."""

from __future__ import annotations

import sys
from dataclasses import replace

from hiprl.cli.machine import prepare
from hiprl.config import teachable
from hiprl.session import RunSpec, start
from hiprl.store.rows import PEOPLE
from hiprl.store.store import Store, open_store
from hiprl.teaching import taught
from hiprl.world.build import world_from
from tests.whole.tasks import TINY

CONFIG = teachable(replace(TINY, question=replace(TINY.question, clip=7, candidates=50)))


def begun(store: Store) -> str:
    """A run for it."""
    return start(store, world_from("linear"), RunSpec(seed=3, config=CONFIG, judge=PEOPLE))


if __name__ == "__main__":
    prepare()
    with open_store(sys.argv[1], create=False) as opened:
        taught(opened, sys.argv[2], world_from("linear"))
