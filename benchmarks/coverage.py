"""How often the truth lies in the reward's 90 % intervals, for every kind of answer, on simulated judges.

A true reward is drawn: linear in three of the standardised coordinates, in all, or with a bend in each as well. A judge
perceives the difference of two clips in units of its spread over all clips, with a logistic error of scale --kappa, and
answers in the form of the arm. Then 200 fresh pairs of clips: the share whose true difference lies within mean
± 1.645 σ_g of the predicted one.
The unit of r̂ is what the posterior says it is; `fitted` is the same with the unit that fits the true differences best,
which says what is due to the unit. Means over seeds with the standard error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.common import Report, add_core, one_core, parser, progress
from benchmarks.cost import CLIP, CLIPS, smooth_noise
from benchmarks.runner import seeds_of

if TYPE_CHECKING:
    from hiprl.data.answer import Answer

PAIRS = 200
TRUTHS = ("few", "linear", "bent")
FEW = 3  # coordinates that count
FORMS = ("choice", "level", "slider", "ranking", "rating", "number")


def said(form: str, u: Any, kappa: float, whole: float, rng: Any) -> Answer:
    """What the judge says of clips of these utilities, in units of a whole scale."""
    import numpy as np

    from hiprl.data.answer import choice, level, number, ranking, rating, slider

    fifth = lambda x: float(np.clip(np.round(2 * x), -2, 2))
    if form == "ranking":
        return ranking([int(i) for i in np.argsort(-(u + kappa * rng.gumbel(size=len(u))))])
    if form == "rating":
        return rating(fifth(u[0] + kappa * rng.logistic()), 5)
    if form == "number":
        return number(float(whole * (u[0] - u[1])))
    apart = u[0] - u[1] + kappa * rng.logistic()
    if form == "choice":
        return choice(bool(apart > 0))
    return level(fifth(apart), 5) if form == "level" else slider(float(np.clip(apart, -1, 1)))


def coverage(form: str, answers: int, room: int, *, truth: str, kappa: float, seed: int) -> dict[str, float]:
    """Share of fresh differences in their intervals, and of these with the unit that fits best."""
    import jax
    import numpy as np

    from hiprl.data.preference import Given, Preferences
    from hiprl.models.estimate import estimate_reward
    from hiprl.models.reward import AdditiveConfig

    N, H = 24, 200
    T, rng = smooth_noise(N, H, seed=seed), np.random.default_rng(1000 + seed)
    x = np.concatenate([np.asarray(T.rows.states)[:, :-1], np.asarray(T.rows.actions)], axis=-1)
    x = (x - x.mean(axis=(0, 1))) / x.std(axis=(0, 1))
    n = x.shape[-1]
    counts = rng.permutation(n) < FEW if truth == "few" else np.ones(n, bool)
    r = x @ (counts * rng.normal(size=n))
    if truth == "bent":
        r = r + np.tanh(2 * x - rng.normal(size=n)) @ rng.normal(size=n)
    total = lambda r: np.cumsum(np.pad(r, ((0, 0), (1, 0))), axis=1)
    of = lambda C, i, t: C[i, t + CLIP] - C[i, t]
    C = total(r)
    whole = np.std(of(C, np.arange(N)[:, None], np.arange(H - CLIP + 1)[None]))
    middle = np.mean(r) * CLIP
    given = []
    for _ in range(answers):
        m = CLIPS.get(form, 2)
        i, t = rng.integers(N, size=m), rng.integers(H - CLIP + 1, size=m)
        u = (of(C, i, t) - middle) / whole
        given.append(
            Given(
                said(form, u, kappa, float(whole), rng),
                [(int(a), int(b), CLIP) for a, b in zip(i, t, strict=True)],
                0,
                N,
            )
        )
    P = Preferences.of(given, room, m=max(2, CLIPS.get(form, 2)))
    reward = estimate_reward(P, T, None, AdditiveConfig())
    i, t = rng.integers(N, size=(PAIRS, 2)), rng.integers(H - CLIP + 1, size=(PAIRS, 2))
    true = of(C, i, t) / whole
    true = true[:, 0] - true[:, 1]
    phi = lambda i, t: reward_sum(reward, T, i, t)
    psi = phi(i[:, 0], t[:, 0]) - phi(i[:, 1], t[:, 1])
    gap = jax.vmap(reward.gap_of)(psi)
    unit = 1 / whole if form == "number" else float(reward.errors.scale)  # numbers tell the unit of the reward
    mean, sigma = np.asarray(gap.mean) * unit, np.asarray(gap.sigma) * unit
    inside = lambda size: float(np.mean(np.abs(size * true - mean) <= 1.645 * sigma))
    right = float(np.mean((mean > 0) == (true > 0)))
    return {"covered": inside(1.0), "fitted": inside((true @ mean) / (true @ true)), "in_order": right}


def reward_sum(reward: Any, T: Any, i: Any, t: Any) -> Any:
    """Sum of φ over these clips."""
    import jax
    import jax.numpy as jnp

    from hiprl.data.preference import Clip
    from hiprl.models.evidence import clip_sums

    clips = Clip(jnp.asarray(i), jnp.asarray(t), jnp.full(len(i), CLIP))
    return jax.jit(clip_sums, static_argnames="steps")(reward.features, T, clips, steps=CLIP)


def main() -> None:
    """Asks, learns, counts and reports."""
    made = parser(__doc__)
    add_core(made)
    made.add_argument("--seeds", default="0-19", metavar="A-B", help="seeds, as 0-9 or 3,5,7")
    made.add_argument("--answers", nargs="+", type=int, default=[10, 30, 100], help="answers that there are")
    made.add_argument("--forms", nargs="+", default=list(FORMS), choices=FORMS, help="kinds of answers")
    made.add_argument("--kappa", type=float, default=0.1, help="scale of the judge's error, where a whole scale is 1")
    options = made.parse_args()
    one_core(options.core)
    if options.quick:
        options.seeds, options.answers, options.forms = "0", [7], ["choice"]

    import numpy as np

    from hiprl.cli.machine import prepare

    prepare()
    report, seeds = Report("Share of true differences in 90 % intervals"), seeds_of(options.seeds)
    for form in options.forms:
        for truth in TRUTHS:
            for answers in options.answers:
                more = {"truth": truth, "kappa": options.kappa}
                found = [coverage(form, answers, max(options.answers), seed=seed, **more) for seed in seeds]
                mean = {name: float(np.mean([one[name] for one in found])) for name in found[0]}
                error = float(np.std([one["covered"] for one in found]) / np.sqrt(len(found)))
                report.add(form=form, truth=truth, answers=answers, **mean, error=error)
                progress(f"{form}, {truth}, {answers}: {mean['covered']:.3f}")
    report.show()
    report.write(options.json, seeds=seeds, kappa=options.kappa)


if __name__ == "__main__":
    main()
