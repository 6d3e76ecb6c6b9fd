"""What a run's answers say: T and P from the store, the reward learned from them again, and how good it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from hiprl.data.preference import WHOLE, Clip, Preferences
from hiprl.data.trajectory import trajectory_from
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.models.estimate import RewardConfig, estimate_reward
from hiprl.models.quality import Held, cross_validated
from hiprl.models.reward import AdditiveConfig, AdditiveReward
from hiprl.store.rows import QuestionRow, RunRow
from hiprl.store.store import Store


def evidence_of(store: Store, row: RunRow) -> tuple[Trajectories, Preferences]:
    """All trajectories of a run and all its answers; of an answer that was corrected, the newest.

    Raises:
        InputError: nothing was answered yet.
    """
    taus, asked = store.trajectories(row.id), [q for q in store.questions(row.id) if q.answer is not None]
    if not asked:
        raise InputError(
            f"run {row.id} has no answers yet; at least one is needed to learn a reward from. "
            f"Let it go on with `hiprl resume {row.id}`."
        )
    H = int(row.spec["horizon"])
    p, q = taus[0].states.shape[1], taus[0].actions.shape[1]
    T = Trajectories.empty(len(taus), H=H, p=p, q=q)
    for tau in taus:
        T = T.add(trajectory_from(tau.states, tau.actions, H=H, terminated=tau.terminated, rewards=tau.rewards))
    judges = {name: i for i, name in enumerate(dict.fromkeys(answer.judge for answer in store.answers(row.id)))}
    by_k = {answer.k: judges[answer.judge] for answer in store.answers(row.id)}
    P = Preferences.empty(len(asked), m=max(2, *(len(question.clips) for question in asked)))
    for question in asked:
        assert question.answer is not None
        # episode k's question came when k + 1 trajectories were there
        P = P.answered(question.answer, clips_of(question), judge=by_k[question.k], at_hand=jnp.asarray(question.k + 1))
    return T, P


def clips_of(question: QuestionRow) -> list[Clip]:
    """What a question shows."""
    return [Clip.at(clip.of, clip.start, WHOLE if clip.length is None else clip.length) for clip in question.clips]


def relearned(T: Trajectories, P: Preferences, config: AdditiveConfig) -> AdditiveReward:
    """The reward learned from these answers, from nothing."""
    reward = estimate_reward(P, T, None, config)
    assert isinstance(reward, AdditiveReward)
    return reward


def as_said(P: Preferences, form: str) -> Preferences:
    """The same answers with less in them: numbers and levels as mere choices."""
    if form == "all":
        return P
    middle = jnp.clip(P.said.low, -1e9, 1e9) + jnp.clip(P.said.high, -1e9, 1e9)
    above, below = middle > 0, middle < 0
    level = jnp.where(P.said.kind == 0, 1, P.said.kind)
    low = jnp.where(above, 0.0, -jnp.inf)
    high = jnp.where(below, 0.0, jnp.inf)
    told = P.said.kind <= 1
    said = replace(
        P.said,
        kind=level,
        low=jnp.where(told, low, P.said.low),
        high=jnp.where(told, high, P.said.high),
    )
    return replace(P, said=said)


def quality(T: Trajectories, P: Preferences, config: RewardConfig, *, folds: int = 10) -> dict[str, Any]:
    """How good the learned reward is, by answers that were kept from it: plain numbers, None where not known."""
    held: Held = cross_validated(P, T, config, folds=folds)
    return {
        "answers": int(P.count),
        "held_out_accuracy": held.mean("right"),
        "held_out_log_likelihood": held.mean("log_likelihood"),
        "coverage_90": held.mean("covered"),
        "consistency": consistency(P),
    }


def consistency(P: Preferences) -> float | None:
    """Share of the questions asked twice that got the same side twice; None if none was."""
    n = int(P.count)
    low, high = (np.clip(np.asarray(x)[:n], -1e9, 1e9) for x in (P.said.low, P.said.high))
    side = np.sign(low + high)
    clips = np.stack([np.asarray(x)[:n] for x in (P.clips.of, P.clips.start, P.clips.length)], axis=-1)
    agreed = []
    for i in range(n):
        for j in range(i):
            same, turned = (clips[i] == clips[j]).all(), (clips[i] == clips[j][::-1]).all()
            if same or turned:
                agreed.append(side[i] == (side[j] if same else -side[j]))
    return float(np.mean(agreed)) if agreed else None
