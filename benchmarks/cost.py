"""What an answer costs: the refit of the reward after it, and the choice of the next question. Nothing is trained.

Trajectories are smooth noise in as many coordinates as a HalfCheetah has (17 of the state, 6 of the action), 60 of 1000
steps. A judge without error who likes two of the coordinates has answered as many questions as there is room for; a
refit is what happens after one more answer, from clips to the posterior. Arms are the kinds of answers, `mixed` all in
turn; `erring` is choices of two judges, whose mistakes are found too. A question is picked among --candidates pairs by
what its answer is expected to tell.

The table has CPU milliseconds (best of --repeats), time passed beside them, and seconds for the first call, which
compiles.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from benchmarks.common import Report, add_core, one_core, parser, progress, timed

if TYPE_CHECKING:
    from hiprl.data.preference import Preferences
    from hiprl.data.trajectory_set import Trajectories

P_STATE, Q_ACTION, CLIP = 17, 6, 50
FORMS = {
    "choices": ["choice"],
    "levels": ["level"],
    "sliders": ["slider"],
    "rankings": ["ranking"],
    "ratings": ["rating"],
    "numbers": ["number"],
    "mixed": ["choice", "level", "slider", "number", "equal"],
    "erring": ["choice"],
}
CLIPS = {"ranking": 4, "rating": 1}


def smooth_noise(trajectories: int, steps: int, *, seed: int) -> Trajectories:
    """Trajectories whose coordinates wander, those of the action faster; the reward is of two of them."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from hiprl.data.trajectory import Trajectory
    from hiprl.data.trajectory_set import Trajectories

    rng = np.random.default_rng(seed)
    n = P_STATE + Q_ACTION
    speed = np.concatenate([np.full(P_STATE, 0.05), np.full(Q_ACTION, 0.5)])
    x = np.zeros((trajectories, steps + 1, n))
    x[:, 0] = rng.normal(size=(trajectories, n))
    drive = rng.normal(size=x.shape)
    for t in range(steps):
        x[:, t + 1] = np.sqrt(1 - speed) * x[:, t] + np.sqrt(speed) * drive[:, t]
    states, actions = x[..., :P_STATE], np.tanh(x[:, :-1, P_STATE:])
    rewards = states[:, 1:, 8] - 0.1 * np.sum(actions**2, axis=-1)
    length = jnp.full(trajectories, steps, jnp.int32)
    arrays = [jnp.asarray(a, jnp.float32) for a in (states, actions, rewards)]
    rows = Trajectory(*arrays, length, *[jnp.zeros(trajectories, bool)] * 2)
    return jax.block_until_ready(Trajectories(rows, jnp.asarray(trajectories, jnp.int32)))


def answered(T: Trajectories, forms: list[str], answers: int, *, judges: int = 1, seed: int = 0) -> Preferences:
    """P with so many answers about random clips, in turn of these forms; each about what was there at its time."""
    import numpy as np

    from hiprl.data.answer import EQUALLY_GOOD, Answer, choice, level, number, ranking, rating, slider
    from hiprl.data.preference import Given, Preferences

    rng = np.random.default_rng(seed)
    paid = np.cumsum(np.pad(np.asarray(T.rows.rewards, float), ((0, 0), (1, 0))), axis=1)
    N, steps = T.capacity, paid.shape[1] - 1
    size = float(np.std(paid[:, CLIP:] - paid[:, :-CLIP]))
    fifth = lambda u: float(np.clip(np.round(2 * u), -2, 2))

    def said(form: str, u: list[float]) -> Answer:
        apart = u[0] - u[-1]
        match form:
            case "choice":
                return choice(apart > 0)
            case "level":
                return level(fifth(apart), 5)
            case "slider":
                return slider(float(np.clip(apart, -1, 1)))
            case "ranking":
                return ranking([int(i) for i in np.argsort(-np.asarray(u))])
            case "rating":
                return rating(fifth(u[0]), 5)
            case "equal":
                return EQUALLY_GOOD
            case _:
                return number(apart * size)

    given = []
    for k in range(answers):
        form = forms[k % len(forms)]
        there = max(2, min(N, 2 + k * N // answers))
        clips = [
            (int(rng.integers(there)), int(rng.integers(steps - CLIP + 1)), CLIP) for _ in range(CLIPS.get(form, 2))
        ]
        u = [float(paid[i, t + n] - paid[i, t]) / size for i, t, n in clips]
        given.append(Given(said(form, u), clips, k % judges, there))
    return Preferences.of(given, answers, m=max(2, *(CLIPS.get(form, 2) for form in forms)))


def main() -> None:
    """Times both and reports."""
    made = parser(__doc__)
    add_core(made)
    made.add_argument("--answers", nargs="+", type=int, default=[30, 200], help="answers that there are")
    made.add_argument("--arms", nargs="+", default=list(FORMS), choices=FORMS, help="kinds of answers")
    made.add_argument("--candidates", type=int, default=10_000, help="pairs among which a question is picked")
    made.add_argument("--repeats", type=int, default=7, help="calls, of which the best counts")
    made.add_argument("--seed", type=int, default=0, help="of trajectories and questions")
    options = made.parse_args()
    one_core(options.core)
    trajectories, steps = 60, 1000
    if options.quick:
        trajectories, steps, options.answers, options.candidates, options.repeats = 5, 100, [7], 100, 1

    import jax
    import jax.random as jr

    from hiprl.cli.machine import prepare
    from hiprl.feedback.questions import QuestionConfig, pick_clips
    from hiprl.models.estimate import estimate_reward
    from hiprl.models.reward import AdditiveConfig

    prepare()
    T, config = smooth_noise(trajectories, steps, seed=options.seed), AdditiveConfig()
    report = Report("What an answer costs, in milliseconds")
    for count in options.answers:
        for arm in options.arms:
            judges = 2 if arm == "erring" else 1
            P = answered(T, FORMS[arm], count, judges=judges, seed=options.seed)
            refit = lambda P=P: estimate_reward(P, T, None, config)
            began = time.perf_counter()
            reward = jax.block_until_ready(refit())
            first = time.perf_counter() - began
            took = timed(refit, repeats=options.repeats)
            report.add(what="refit", answers=count, arm=arm, cpu=1e3 * took.cpu, wall=1e3 * took.wall, first_s=first)
            progress(f"{arm}, {count}: {1e3 * took.seconds:.0f} ms")
            if arm in ("choices", "levels", "numbers") and count == options.answers[-1]:
                levels = {"choices": 2, "levels": 5, "numbers": None}[arm]
                asked = QuestionConfig(
                    clip=CLIP, pick="information", levels=levels, candidates=options.candidates, aligned=0.0
                )
                pick = lambda reward=reward, asked=asked: pick_clips(T, reward, asked, key=jr.key(options.seed))
                began = time.perf_counter()
                jax.block_until_ready(pick())
                first = time.perf_counter() - began
                took = timed(pick, repeats=options.repeats)
                report.add(
                    what="question", answers=count, arm=arm, cpu=1e3 * took.cpu, wall=1e3 * took.wall, first_s=first
                )
    report.notes.append(
        f"{trajectories} trajectories of {steps} steps, {P_STATE + Q_ACTION} coordinates; a question is picked among "
        f"{options.candidates} pairs."
    )
    report.show()
    report.write(options.json, seed=options.seed, candidates=options.candidates)


if __name__ == "__main__":
    main()
