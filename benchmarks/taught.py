"""Behaviours taught through the page: `hiprl teach`, a real browser, and a scripted person who sees the bodies alone.

The person presses one of five keys for each pair of clips, by where the bodies were, and knows no reward. What was
learned is then measured in the world: for the tasks with a reward that wants the same by that, for the others by the
speed of the body. Needs Playwright (in hiprl's extra `dev`) and a Chromium of the system.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.clicker import Person, chromium, started
from benchmarks.common import Report, parser, progress
from benchmarks.runner import seeds_of

PAUSE = 2.0  # seconds that the person looks at a pair


class Wish(NamedTuple):
    """Something that a person may want."""

    env: str
    words: str
    better: Callable[[np.ndarray], float]
    bodies: int


def upright(poses: np.ndarray) -> float:
    """How long a pole stands, and how straight."""
    tilt = 2 * np.arccos(np.clip(np.abs(poses[:, 2, 3]), 0, 1))
    return len(poses) / 50 - float(np.mean(tilt))


def along(direction: float) -> Callable[[np.ndarray], float]:
    """How fast the body goes along x, in metres a second at 20 frames a second, while it is not on its back."""
    return lambda poses: direction * float(poses[-1, 1, 0] - poses[0, 1, 0]) / (max(len(poses) - 1, 1) / 20)


def hopping(poses: np.ndarray) -> float:
    """How far it gets in the clip, and how long it stays up."""
    return float(poses[-1, 1, 0] - poses[0, 1, 0]) + len(poses) / 50


WISHES = {
    "balance": Wish("InvertedPendulum-v5", "keep the pole upright", upright, 3),
    "forward": Wish("HalfCheetah-v5", "run forwards", along(1.0), 8),
    "backward": Wish("HalfCheetah-v5", "run backwards", along(-1.0), 8),
    "hop": Wish("Hopper-v5", "hop forwards without falling", hopping, 5),
}


def taught(wish: Wish, *, answers: int, seed: int, store: str) -> dict[str, Any]:
    """Teaches one behaviour; gives what came of it."""
    from hiprl.store.store import open_store

    began = time.monotonic()
    words = ["teach", wish.env, "--goal", wish.words, "--comparisons", str(answers), "--seed", str(seed)]
    with started(*words, "--store", store, "--port", "8700", "--no-browser") as trainer, chromium() as browser:
        page = browser.new_page()
        person = Person(page, wish.better, bodies=wish.bodies)
        page.goto(trainer.address)
        page.wait_for_selector("#setup[open], #answers:not([hidden])", timeout=120_000)
        if page.locator("#setup[open]").count():
            page.keyboard.press("Escape")
        given = person.answer(answers, pause=PAUSE)
        page.close()
        trainer.process.wait(1200)
        if trainer.process.returncode:
            raise SystemExit("".join(trainer.said))
    with open_store(store, create=False) as opened:
        run = opened.runs()[0].id
        final = opened.final(run)
        assert final is not None
        newest = opened.newest(run, "policy")
    waits = sorted(person.waits)
    return {
        "answers": given,
        "return": final["return_mean"],
        "return_std": final["return_std"],
        "episodes": newest,
        "env_steps": final["env_steps"],
        "wait_95": waits[int(0.95 * (len(waits) - 1))] if waits else None,
        "minutes": (time.monotonic() - began) / 60,
        "by_person": by_person(wish, store, run),
    }


def by_person(wish: Wish, store: str, run: str) -> float:
    """What the person makes of an episode of the learned policy, per 50 steps."""
    import jax.random as jr

    import hiprl
    from hiprl.world.build import world_from

    learned = hiprl.load(run, store=store)
    world = world_from(wish.env)
    world.start_filming()
    world.roll_out(learned.actor, key=jr.key(12345))
    film = world.film
    assert film is not None and film.poses is not None
    clips = [film.poses[t : t + 51] for t in range(0, len(film.poses) - 1, 50)]
    return float(np.mean([wish.better(clip) for clip in clips]))


def main() -> None:
    """Teaches and reports."""
    made = parser(__doc__)
    made.add_argument("--wishes", nargs="+", default=list(WISHES), choices=WISHES, help="what is taught")
    made.add_argument("--answers", type=int, default=30, help="answers that the person gives")
    made.add_argument("--seeds", default="0", metavar="A-B", help="seeds of the runs, as 0-9 or 3,5,7")
    made.add_argument("--folder", type=Path, default=Path("runs/benchmarks/taught"), help="where the stores are kept")
    options = made.parse_args()
    if options.quick:
        options.wishes, options.answers = ["balance"], 6
    from hiprl.cli.machine import prepare

    prepare()
    report = Report("Taught through the page")
    for name in options.wishes:
        for seed in seeds_of(options.seeds):
            progress(f"{name}, seed {seed}")
            store = options.folder / f"{name}.{seed}.db"
            store.parent.mkdir(parents=True, exist_ok=True)
            store.unlink(missing_ok=True)
            found = taught(WISHES[name], answers=options.answers, seed=seed, store=str(store))
            report.add(wish=name, env=WISHES[name].env, seed=seed, **found)
    report.notes.append(
        "by_person: what the person makes of 50 steps of the learned policy (balance: 1 is upright all the time; "
        "forward and backward: m/s). wait_95: seconds from an answer to the next pair, 95th percentile."
    )
    report.show()
    report.write(options.json)


if __name__ == "__main__":
    main()
