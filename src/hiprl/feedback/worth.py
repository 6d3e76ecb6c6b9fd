"""What one more answer is worth: by how much it is expected to raise the best return that is in sight, by r̂.

An answer is worth something only if it can change what is done. What can be done is what was seen: to keep up, for a
whole episode, what any clip shows. So the worth of a question is how much better, in expectation, the best clip is for
who knows the answer than the one that seems best now.
Source: the knowledge gradient, Frazier, Powell and Dayanik (2009), with questions for its measurements.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hiprl.data.preference import Clip
from hiprl.data.trajectory_set import Trajectories
from hiprl.feedback.questions import NODES, WEIGHTS, QuestionConfig, answers_given, apart, cuts_between, drawn, phi_of
from hiprl.models.evidence import clip_sums
from hiprl.models.reward import AdditiveReward
from hiprl.types import Key, Scalar

CANDIDATES = 300  # questions that are weighed up
SPAN = 50  # steps of a clip that shows a behaviour


@partial(jax.jit, static_argnames=("config",))
def worth(T: Trajectories, reward: AdditiveReward, config: QuestionConfig, *, key: Key) -> Scalar:
    """Expected gain by the answer to the best question, over what the best behaviour exceeds the average episode.

    Both are per step, and the behaviour is kept up for a whole episode. 0 says that no answer is expected to change
    what is wanted; 0.1 that what is then done is better by a tenth of what is to be had; 1, which is the most, that
    nearly nothing is known yet. NaN for questions about more than two clips.

    Args:
        T: the trajectories.
        reward: r̂ with its posterior.
        config: what is asked.
        key: for the questions that are weighed up.
    """
    if config.items > 2:
        return jnp.asarray(jnp.nan)
    config = replace(config, candidates=CANDIDATES)
    asked = drawn(T, config, key=key)
    psi = apart(phi_of(T, reward.features, asked.clips, config), asked.shown)[:, 0]
    Phi, there = seen(T, reward)
    returns = Phi @ reward.mean
    half_psi, half_Phi = psi @ reward.root.T, Phi @ reward.root.T
    cov = (psi * reward.prior[None]) @ Phi.T - half_psi @ half_Phi.T  # of each answer with each return
    var = jnp.maximum(jnp.sum(psi**2 * reward.prior[None], axis=1) - jnp.sum(half_psi**2, axis=1), 0.0)
    std = jnp.sqrt(var)
    u = (psi @ reward.mean)[:, None] + std[:, None] * jnp.asarray(NODES)[None]  # (n, nodes)
    if config.levels is None:  # a number says what the difference is
        p = jnp.broadcast_to(jnp.eye(len(NODES))[None], (*u.shape, len(NODES)))
    else:
        given = jax.vmap(jax.vmap(answers_given, in_axes=(0, None, None)), in_axes=(0, None, None))
        p = given(u * reward.errors.scale, cuts_between(config.levels), reward.errors.kappa)  # (n, nodes, answers)
    weights = jnp.asarray(WEIGHTS / WEIGHTS.sum())
    chance = jnp.einsum("j,njl->nl", weights, p)
    shift = jnp.einsum("j,j,njl->nl", weights, jnp.asarray(NODES), p) / jnp.maximum(chance, 1e-12)  # of u, in std
    slope = jnp.where(std > 0, 1 / jnp.maximum(std, 1e-30), 0.0)[:, None] * cov
    after = returns[None, None] + shift[:, :, None] * slope[:, None]  # (n, answers, N)
    best = jnp.max(jnp.where(there[None, None], after, -jnp.inf), axis=-1)
    now = jnp.max(jnp.where(there, returns, -jnp.inf))
    gain = jnp.max(jnp.sum(chance * best, axis=1) - now)
    episodes = jnp.where(T.real, reward.returns(T), 0.0)  # one that ended early earned no more
    mean = jnp.sum(episodes) / jnp.maximum(jnp.sum(T.real) * T.rows.actions.shape[1], 1)
    return jnp.clip(gain / jnp.maximum(now - mean, 1e-12), 0.0, 1.0)


def seen(T: Trajectories, reward: AdditiveReward) -> tuple[Float[Array, "n D"], Bool[Array, " n"]]:
    """Mean of φ over clips from everywhere in T, and which of them are there and were executed."""
    H = T.rows.actions.shape[1]
    starts = jnp.arange(0, H, SPAN)
    at = Clip(*jnp.broadcast_arrays(jnp.arange(T.capacity)[:, None], starts[None], jnp.asarray(SPAN)))
    steps = jnp.minimum(T.rows.length[:, None] - at.start, SPAN)
    longest = jnp.max(jnp.where(T.real, T.rows.length, 0))  # where all soon fall, shorter ones show a behaviour
    there = T.real[:, None] & (steps >= jnp.maximum(jnp.minimum(SPAN, longest) // 2, 1))
    flat = jax.tree.map(lambda x: x.reshape(-1), at)
    return clip_sums(reward.features, T, flat, SPAN) / jnp.maximum(steps.reshape(-1), 1)[:, None], there.reshape(-1)
