"""Behaviours taught through the page: `hiprl teach`, a real browser, and a scripted person who sees the bodies alone.

The person presses one of five keys for each pair of clips, by where the bodies were (by the states, where no body is
drawn), and knows no reward. What was learned is then measured in the world: for the tasks with a reward that wants the
same by that, for the others by what the person sees. Needs Playwright (in hiprl's extra `dev`) and a Chromium of the
system.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from benchmarks.clicker import Person, chromium, started
from benchmarks.common import Report, parser, progress
from benchmarks.runner import seeds_of

PAUSE = 2.0  # seconds that the person looks at a pair
EPISODES = 10  # of what was learned, to see what it came to
PATIENCE = 900.0  # and waits for one on a busy machine; how long they waited is reported


class Wish(NamedTuple):
    """Something that a person may want."""

    env: str
    words: str
    better: Callable[[np.ndarray], float]
    frame: tuple[int, ...]
    """Shape of what is seen at one moment: (bodies, 7) poses, or (p,) states where no bodies are."""
    horizon: int | None = None
    """Steps of an episode, where the environment does not say."""


def upright(poses: np.ndarray) -> float:
    """How long a pole stands, and how straight."""
    tilt = 2 * np.arccos(np.clip(np.abs(poses[:, 2, 3]), 0, 1))
    return len(poses) / 50 - float(np.mean(tilt))


def along(direction: float) -> Callable[[np.ndarray], float]:
    """How fast the body goes along x, in metres a second at 20 frames a second, whichever side of it is up."""
    return lambda poses: direction * float(poses[-1, 1, 0] - poses[0, 1, 0]) / (max(len(poses) - 1, 1) / 20)


def hopping(poses: np.ndarray) -> float:
    """How far it gets in the clip, and how long it stays up."""
    return float(poses[-1, 1, 0] - poses[0, 1, 0]) + len(poses) / 50


def standing(poses: np.ndarray) -> float:
    """How long it stays up, and how near to where it was."""
    return len(poses) / 50 - abs(float(poses[-1, 1, 0] - poses[0, 1, 0]))


def near_the_post(states: np.ndarray) -> float:
    """How close the cart is to the post, over the clip."""
    return -float(np.mean(np.abs(states[:, 0] - 1.0)))


class Cart(gym.Env):
    """An environment of one's own: a cart on a line, pushed. It pays nothing and never ends."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,))
    action_space = gym.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Somewhere left of the post, at rest."""
        super().reset(seed=seed)
        self.x, self.v = self.np_random.uniform(-2.0, 0.0), 0.0
        return np.array([self.x, self.v]), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, None, bool, bool, dict]:
        """A twentieth of a second."""
        self.v += 0.05 * (2.0 * float(action[0]) - 0.2 * self.v)
        self.x += 0.05 * self.v
        return np.array([self.x, self.v]), None, False, False, {}


WISHES = {
    "balance": Wish("InvertedPendulum-v5", "keep the pole upright", upright, (3, 7)),
    "forward": Wish("HalfCheetah-v5", "run forwards", along(1.0), (8, 7)),
    "backward": Wish("HalfCheetah-v5", "run backwards", along(-1.0), (8, 7)),
    "hop": Wish("Hopper-v5", "hop forwards without falling", hopping, (5, 7)),
    "stand": Wish("Hopper-v5", "stand on the spot without falling", standing, (5, 7)),
    "swing": Wish("Pendulum-v1", "swing up and stay up", lambda states: float(np.mean(states[:, 0])), (3,)),
    "post": Wish("benchmarks.taught:Cart", "go to the post at 1 and stay there", near_the_post, (2,), 100),
}


def taught(wish: Wish, *, answers: int, seed: int, store: str) -> dict[str, Any]:
    """Teaches one behaviour; gives what came of it."""
    from hiprl.store.store import open_store

    began = time.monotonic()
    words = ["teach", wish.env, "--goal", wish.words, "--comparisons", str(answers), "--seed", str(seed)]
    words += [] if wish.horizon is None else ["--horizon", str(wish.horizon)]
    with started(*words, "--store", store, "--port", "8700", "--no-browser") as trainer, chromium() as browser:
        page = browser.new_page()
        person = Person(page, wish.better, frame=wish.frame)
        page.goto(trainer.address)
        page.wait_for_selector("#setup[open], #answers:not([hidden])", timeout=120_000)
        if page.locator("#setup[open]").count():
            page.keyboard.press("Escape")
        given = person.answer(answers, pause=PAUSE, patience=PATIENCE)
        person.leave()
        trainer.process.wait(1200)
        if trainer.process.returncode:
            raise SystemExit("".join(trainer.said))
    with open_store(store, create=False) as opened:
        run = opened.runs()[0].id
        final = opened.final(run)
        assert final is not None
        newest = opened.newest(run, "policy")
        episodes = None if newest is None else opened.executed_before(run, newest)
    waits = sorted(person.waits)
    return {
        "answers": given,
        "return": final["return_mean"],
        "return_std": final["return_std"],
        "episodes": episodes,
        "env_steps": final["env_steps"],
        "wait_95": waits[int(0.95 * (len(waits) - 1))] if waits else None,
        "minutes": (time.monotonic() - began) / 60,
        **by_person(wish, store, run),
    }


def by_person(wish: Wish, store: str, run: str) -> dict[str, float]:
    """What the person makes of ten episodes of the learned policy, per 50 steps, and of the last 50 of each."""
    import jax.random as jr

    import hiprl
    from hiprl.world.build import world_from

    learned = hiprl.load(run, store=store)
    world = world_from(wish.env, horizon=wish.horizon)
    world.start_filming()
    worths: list[list[float]] = []
    for key in jr.split(jr.key(12345), EPISODES):
        tau = world.roll_out(learned.actor, key=key).seen()
        film = world.film
        frames = tau.states if film is None or film.poses is None else film.poses
        worths.append([wish.better(frames[t : t + 51]) for t in range(0, len(frames) - 1, 50)])
    return {
        "by_person": float(np.mean([np.mean(each) for each in worths])),
        "at_the_end": float(np.mean([each[-1] for each in worths])),
    }


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
            progress(f"{name}, seed {seed}: {found}")  # all of them take an hour
    report.notes.append(
        "by_person: what the person makes of 50 steps of the learned policy, at_the_end of the last 50, means of ten "
        "episodes (balance, stand, swing: 1 is upright all along; forward and backward: m/s; post: minus the metres "
        "from it). wait_95: seconds from an answer to the next pair, 95th percentile."
    )
    report.show()
    report.write(options.json)


if __name__ == "__main__":
    main()
