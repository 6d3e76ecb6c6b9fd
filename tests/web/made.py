"""A run that is taught, in a store: filmed trajectories, three questions, nothing answered."""

from __future__ import annotations

import numpy as np

from hiprl.config import Config, teachable
from hiprl.data.film import Film
from hiprl.data.trajectory import trajectory_from
from hiprl.spec import to_plain
from hiprl.store.rows import PEOPLE, ClipRow
from hiprl.store.store import Store

H, BODIES = 40, 3
IMAGINED = 1  # the trajectory that nobody executed
STANDING = {"pos": [0, 0, 0], "quat": [1, 0, 0, 0]}
SCENE = {
    "kind": "mujoco",
    "dt": 0.05,
    "bodies": BODIES,
    "geoms": [
        {"body": 1, "type": "sphere", "size": [0.1, 0, 0], "rgba": [1, 0, 0, 1]} | STANDING,
        {"body": 2, "type": "box", "size": [0.1, 0.2, 0.1], "rgba": [0, 1, 0, 1]} | STANDING,
    ],
    "meshes": [],
}


def poses(i: int, n: int) -> np.ndarray:
    """Two bodies that go along x at their own speeds."""
    found = np.zeros((n + 1, BODIES, 7), np.float32)
    found[..., 3] = 1
    t = np.arange(n + 1) / 20
    found[:, 1, 0], found[:, 2, 0], found[:, 1:, 2] = i * t, -i * t, 0.5
    return found


def a_taught_run(
    store: Store, *, trajectories: int = 3, questions: int = 3, filmed: bool = True, judge: str = PEOPLE
) -> str:
    """Its id."""
    spec = {"config": to_plain(teachable(Config())), "horizon": H, "judge": judge}
    run_id = store.add_run("Hopper-v5", 0, spec, {})
    store.set_scene(run_id, SCENE if filmed else {"kind": "states", "dt": 0.05, "names": ["x", "y"]})
    for i in range(trajectories):
        n = H - 7 * i
        states = np.stack([np.arange(n + 1) * i, np.ones(n + 1)], axis=1)
        tau = trajectory_from(states, np.zeros((n, 1)), H=H, terminated=i > 0, imagined=i == IMAGINED).seen()
        film = Film(poses=poses(i, n)).to_bytes() if filmed else None
        store.add_trajectory(run_id, i, tau, "random" if i < IMAGINED else "policy", film=film)
    for k in range(1, questions + 1):
        store.ask(run_id, k, [ClipRow(k % trajectories, 5, 10), ClipRow((k + 1) % trajectories, 0, None)])
    return run_id
