"""A trainer without learning: writes episodes whose arrays follow from k alone. Tests run it and kill it."""

from __future__ import annotations

import sys
from itertools import count, islice

import numpy as np

from hiprl.data.answer import number as a_number
from hiprl.store.rows import ClipRow, TrajectoryRow
from hiprl.store.store import Store, open_store

P, Q = 5, 3


def trajectory(number: int, length: int = 7) -> TrajectoryRow:
    draw = np.random.default_rng([11, number])
    return TrajectoryRow(
        number=number,
        kind="random" if number < 2 else "policy",
        states=draw.normal(size=(length + 1, P)).astype(np.float32),
        actions=draw.uniform(-1, 1, (length, Q)).astype(np.float32),
        rewards=np.full(length, np.nan, np.float32),
        length=length,
        terminated=number % 2 == 0,
    )


def checkpoint(k: int) -> bytes:
    return np.random.default_rng([13, k]).bytes(50_000)


def go_on(store: Store, run_id: str, *, episodes: int | None) -> None:
    """Resume the run as a trainer does, for so many episodes; for ever, if None."""
    for number in range(2):
        store.add_trajectory(run_id, number, trajectory(number), "random")
    at = store.checkpoint(run_id)
    for k in islice(count(at[0] + 1 if at else 1), episodes):
        store.open_question(run_id, k, [trajectory(k + 1)], [ClipRow(k + 1), ClipRow(k)])
        if store.answer_of(run_id, k) is None:
            store.answer(run_id, k, a_number(k / 3), "writer")
        store.finish_episode(run_id, k, {"k": k, "return": k / 7}, checkpoint(k))
        sys.stdout.write(f"{k}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    with open_store(sys.argv[1]) as store, store.lease(sys.argv[2]):
        go_on(store, sys.argv[2], episodes=None)
