"""What questions teach: how well r̂ ranks clips that were not asked about, after each number of choices.

Nothing is trained. The trajectories are those of runs that learned (`answers.py`, arm `numeric`), and choices about
clips of 50 steps are asked about them again: answer k about what was there at episode k of that run. `information`
picks what is expected to tell most, `uniform` the newest trajectory and any older one, at random places. The judge is
the scripted `choice`, by the environment's own reward.

The table has the share of 2000 random pairs of clips that r̂ puts in the right order, over the trajectories of the whole
run, as mean over seeds; and the interquartile mean of the seeds' differences with its 95 % bootstrap interval.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.common import Report, add_core, one_core, parser, progress
from benchmarks.runner import seeds_of

CLIP = 50
PAIRS = 2000
PICKS = ("information", "uniform")


def accuracies(path: Path, pick: str, judge: str, after: list[int], *, seed: int) -> list[float]:
    """Share of held-out pairs in the right order after each of these numbers of answers."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import jax.random as jr
    import numpy as np

    from hiprl.data.preference import Clip, Preferences
    from hiprl.feedback.judges import judge_from
    from hiprl.feedback.judging import checked
    from hiprl.feedback.questions import QuestionConfig, drawn, pick_clips
    from hiprl.models.estimate import estimate_reward
    from hiprl.models.evidence import clip_sum
    from hiprl.models.reward import AdditiveConfig, AdditiveReward
    from hiprl.report.evidence import evidence_of
    from hiprl.spec import from_plain
    from hiprl.store.store import open_store

    with open_store(path, create=False) as store:
        row = store.runs()[0]
        T, asked = evidence_of(store, row)[0], from_plain(row.spec["config"])
    config = QuestionConfig(clip=CLIP, pick=pick, levels=2)
    key, judging = jr.key(seed), judge_from(judge)
    held_out = drawn(T, QuestionConfig(clip=CLIP, candidates=PAIRS), key=jr.fold_in(key, 1 << 20))
    pairs = held_out.clips_of(held_out.shown)
    paid = np.asarray(jax.vmap(jax.vmap(lambda clip: T.clip(clip).true_return))(pairs))

    def in_order(reward: AdditiveReward) -> float:
        sums = jax.vmap(jax.vmap(lambda clip: clip_sum(reward.features, T, clip, CLIP) @ reward.mean))(pairs)
        return float(np.mean((np.asarray(sums[:, 0] - sums[:, 1]) > 0) == (paid[:, 0] > paid[:, 1])))

    reward, P, found = None, Preferences.empty(max(after)), []
    for k in range(1, max(after) + 1):
        at_hand = asked.number_after(k - 1) + 1  # as the run itself had them at answer k
        there = eqx.tree_at(lambda T: T.count, T, jnp.minimum(jnp.asarray(at_hand), T.count))
        reward = estimate_reward(P, there, reward, AdditiveConfig())
        pick_key, ask_key = jr.split(jr.fold_in(key, k))
        clips = pick_clips(there, reward, config, key=pick_key)
        shown = [Clip(clips.of[i], clips.start[i], clips.length[i]) for i in (0, 1)]
        steps = min(int(clips.length[0]), T.rows.actions.shape[1])
        answer = checked(judging, tuple(there.clip(clip) for clip in shown), there, steps=steps, key=ask_key)
        P = P.answered(answer, shown, at_hand=there.count)
        if k in after:
            found.append(in_order(estimate_reward(P, there, reward, AdditiveConfig())))
    return found


def main() -> None:
    """Asks, learns and reports."""
    made = parser(__doc__)
    add_core(made)
    made.add_argument(
        "--stores",
        default="runs/benchmarks/answers/HalfCheetah-v5.numeric.{}.db",
        help="stores of runs; {} is the seed",
    )
    made.add_argument("--seeds", default="30-34", metavar="A-B", help="seeds of the runs, as 0-9 or 3,5,7")
    made.add_argument("--after", nargs="+", type=int, default=[5, 10, 15, 20, 30], help="answers after which to look")
    made.add_argument("--judge", default="choice", help="who answers")
    options = made.parse_args()
    one_core(options.core)
    seeds = seeds_of(options.seeds)[: 1 if options.quick else None]

    import numpy as np

    from hiprl.cli.machine import prepare
    from hiprl.evaluate import interval

    prepare()
    table: dict[str, list[list[float]]] = {pick: [] for pick in PICKS}
    for seed in seeds:
        for pick in PICKS:
            path = Path(options.stores.format(seed))
            table[pick].append(accuracies(path, pick, options.judge, options.after, seed=seed))
            progress(f"seed {seed}, {pick}: " + ", ".join(f"{x:.3f}" for x in table[pick][-1]))
    report = Report("Share of clips that the reward puts in the right order, after so many choices")
    for pick in PICKS:
        means = np.mean(table[pick], axis=0)
        report.add(
            questions=pick,
            seeds=len(seeds),
            **{f"after {k}": float(x) for k, x in zip(options.after, means, strict=True)},
        )
    row: dict[str, Any] = {"questions": "difference", "seeds": len(seeds)}
    for i, k in enumerate(options.after):
        gap = interval([a[i] - b[i] for a, b in zip(*table.values(), strict=True)])
        row[f"after {k}"] = f"{gap.mean:+.3f} ({gap.low:+.3f} to {gap.high:+.3f})"
    report.add(**row)
    report.show()
    report.write(options.json, seeds=seeds, accuracy=table)


if __name__ == "__main__":
    main()
