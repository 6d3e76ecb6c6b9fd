"""Which clips to ask about: those whose answer is expected to tell most, or any."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple, TypeAlias, get_args

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.preference import WHOLE, Clip
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.models.evidence import clip_sums
from hiprl.models.features import AdditiveFeatures
from hiprl.models.reward import AdditiveReward, EstimatedReward
from hiprl.types import Count, Key, Scalar

Pick: TypeAlias = Literal["uniform", "information"]
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(40)
"""Of the expectation over a standard normal."""
POOL = 512  # clips of which questions are made: 130,000 pairs
AGAIN = 1e6  # nats that a question is worth less which was asked before: it is the last resort


@dataclass(frozen=True, kw_only=True)
class QuestionConfig:
    """What a judge is asked."""

    clip: int | None = None
    """Steps of a clip; None for whole trajectories (the paper)."""
    pick: Pick = "uniform"
    """`uniform`: the newest trajectory and any older ones (the paper). `information`: what is expected to tell most."""
    items: int = 2
    """Clips in a question: 2 to compare, 1 to rate, more to rank."""
    levels: int | None = None
    """Answers that there are: 2 for a choice, 5 for five levels; None for a number."""
    candidates: int = 3000
    """Questions that are weighed up to find one."""
    imagined: bool = False
    """Ask about what a new policy does in the model as well, in clips that are marked so."""
    aligned: float = 0.5
    """Share of questions about the newest and the best executed trajectory, by r̂: there the policy is improved."""

    def __post_init__(self) -> None:
        if self.clip is not None and self.clip < 1:
            raise InputError(
                f"got clips of {self.clip} steps; a clip has at least 1, and people judge 2 to 5 seconds best. "
                "Say for example `--clip 50`, or `--clip 0` for whole trajectories."
            )
        if self.pick not in get_args(Pick):
            raise InputError(
                f"got the question picked by {self.pick!r}; it is one of {', '.join(get_args(Pick))}. "
                "Say for example `--ask information`."
            )
        if not 1 <= self.items <= 8 or (self.levels is not None and self.levels < 2):
            raise InputError(
                f"got questions about {self.items} clips with {self.levels} levels; 1 to 8 clips and at least 2 levels "
                "are possible. Take 2 clips, and 2 or 5 levels."
            )
        if self.candidates < 1 or not 0 <= self.aligned <= 1:
            raise InputError(
                f"got {self.candidates} candidates and a share of {self.aligned} aligned questions; at least 1 and a "
                "share from 0 to 1 are needed. Leave both out for the default."
            )


class Questions(NamedTuple):
    """Questions to choose from."""

    clips: Clip
    """A pool of clips, stacked."""
    shown: Int[Array, "n items"]
    """Which of them each question shows."""

    def clips_of(self, shown: Int[Array, "*n"]) -> Clip:
        """These ones of the pool."""
        return jax.tree.map(lambda x: x[shown], self.clips)


@partial(jax.jit, static_argnames=("config",))
def pick_clips(
    T: Trajectories, reward: EstimatedReward, config: QuestionConfig, *, before: Clip | None = None, key: Key
) -> Clip:
    """The clips to ask about, stacked; the newest trajectory of T is among them where nothing else is asked for.

    Args:
        T: the trajectories.
        reward: what is believed of the reward.
        config: what is asked.
        before: what questions have shown, a row each, not to be asked again while anything else tells something.

    Source: HIP-RL Algorithm 1 (τ ~ T) for `uniform`; expected information (BALD), Houlsby et al. (2011).
    """
    if config.pick == "uniform" or not isinstance(reward, AdditiveReward):
        return _uniform(T, config, key=key)
    draw_key, aligned_key, kind_key = jr.split(key, 3)
    anything = drawn(T, config, key=draw_key)
    older = T.real & (jnp.arange(T.capacity) < T.last)
    best = jnp.argmax(jnp.where(older, reward.returns(T), -jnp.inf))
    aligned = _aligned(T, config, T.last, best, key=aligned_key)
    there_are = jnp.any(~twice(aligned.clips_of(aligned.shown)))  # two may not have enough to show
    asked = jax.tree.map(partial(jnp.where, there_are & jr.bernoulli(kind_key, config.aligned)), aligned, anything)
    worth = information(T, reward, asked, config)
    if before is not None:
        worth = worth - AGAIN * was_asked(asked.clips_of(asked.shown), before)
    return asked.clips_of(asked.shown[jnp.argmax(worth)])


def was_asked(clips: Clip, before: Clip) -> Bool[Array, " n"]:
    """Whether the clips in each row are those of a row of `before`, in any order."""
    same = [x[:, None, :, None] == y[None, :, None] for x, y in ((clips.of, before.of), (clips.start, before.start))]
    return jnp.any(jnp.all(jnp.any(same[0] & same[1], axis=3), axis=2), axis=1)


def _uniform(T: Trajectories, config: QuestionConfig, *, key: Key) -> Clip:
    """The newest trajectory, and older ones: none twice while there are others."""
    older_key, start_key = jr.split(key)
    number = jnp.arange(T.capacity)
    order = jnp.argsort(jnp.where(number < T.last, jr.uniform(older_key, (T.capacity,)), 2.0))
    older = order[jnp.arange(config.items - 1) % jnp.maximum(T.last, 1)]
    return _started(T, jnp.append(T.last, older), config, key=start_key)


def drawn(T: Trajectories, config: QuestionConfig, *, key: Key) -> Questions:
    """Questions about any trajectories."""
    of_key, start_key, shown_key = jr.split(key, 3)
    size = config.candidates, config.items
    if config.clip is None:
        return Questions(Clip.whole(jnp.arange(T.capacity)), jr.randint(shown_key, size, 0, T.count))
    pool = _started(T, jr.randint(of_key, (POOL,), 0, T.count), config, key=start_key)
    return Questions(pool, jr.randint(shown_key, size, 0, POOL))


def _aligned(T: Trajectories, config: QuestionConfig, first: Count, second: Count, *, key: Key) -> Questions:
    """Questions about these two trajectories by turns."""
    start_key, shown_key = jr.split(key)
    turn = jnp.arange(config.items) % 2
    size = config.candidates, config.items
    if config.clip is None:
        both = jnp.where(turn == 0, first, second)
        return Questions(Clip.whole(jnp.arange(T.capacity)), jnp.broadcast_to(both, size))
    pool = _started(T, jnp.where(jnp.arange(POOL) % 2 == 0, first, second), config, key=start_key)
    return Questions(pool, 2 * jr.randint(shown_key, size, 0, POOL // 2) + turn[None])


def _started(T: Trajectories, of: Array, config: QuestionConfig, *, key: Key) -> Clip:
    """A clip of each of these trajectories, at a random place."""
    if config.clip is None:
        return Clip(of, jnp.zeros_like(of), jnp.full_like(of, WHOLE))
    latest = jnp.maximum(T.rows.length[of] - config.clip, 0)
    start = jnp.floor(jr.uniform(key, of.shape) * (latest + 1)).astype(jnp.int32)
    return Clip(of, jnp.minimum(start, latest), jnp.full_like(of, config.clip))


def information(
    T: Trajectories, reward: AdditiveReward, asked: Questions, config: QuestionConfig
) -> Float[Array, " n"]:
    """What the answer to each question is expected to tell about r̂, in nats; -∞ for a clip beside itself.

    Of a number it grows with σ_g, of a ranking with the volume of what is unknown of its differences: in these two
    cases only the order means something.
    """
    Phi, clips = phi_of(T, reward.features, asked.clips, config), asked.clips_of(asked.shown)
    mean = apart(Phi @ reward.mean, asked.shown)
    half = apart(Phi @ reward.root.T, asked.shown)
    prior = apart(Phi * jnp.sqrt(reward.prior)[None], asked.shown)
    var = jnp.maximum(jnp.sum(prior**2, axis=-1) - jnp.sum(half**2, axis=-1), 0.0)
    if config.items > 2:
        C = jnp.einsum("nid,njd->nij", prior, prior) - jnp.einsum("nik,njk->nij", half, half)
        noise = (reward.errors.kappa / reward.errors.scale) ** 2
        return _distinct(clips, 0.5 * jnp.linalg.slogdet(jnp.eye(C.shape[-1])[None] + C / noise)[1])
    mean, std = mean[:, 0], jnp.sqrt(var[:, 0])
    if config.levels is None:
        return _distinct(clips, jnp.log(jnp.maximum(std, 1e-30)))
    cuts = cuts_between(config.levels)
    bits = jax.vmap(expected_information, in_axes=(0, 0, None, None))
    kappa, scale = reward.errors.kappa, reward.errors.scale
    return _distinct(clips, bits(mean * scale, std * scale, cuts, kappa))


def expected_information(mean: Scalar, std: Scalar, cuts: Float[Array, " levels_less_1"], kappa: Scalar) -> Scalar:
    """I(answer; u) for u ~ N(mean, std²) perceived with a logistic error and cut into levels, in nats.

    Source: Houlsby et al. (2011), with quadrature in place of the approximation for two levels.
    """
    u = mean + std * jnp.asarray(NODES)
    p = jnp.maximum(jax.vmap(answers_given, in_axes=(0, None, None))(u, cuts, kappa), 1e-12)
    weights = jnp.asarray(WEIGHTS / WEIGHTS.sum())
    entropy = lambda p: -jnp.sum(p * jnp.log(p), axis=-1)
    return entropy(weights @ p) - weights @ entropy(p)


def cuts_between(levels: int) -> Float[Array, " levels_less_1"]:
    """Where one level ends and the next begins, on a scale from -1 to 1."""
    return jnp.arange(1, levels) * 2 / (levels - 1) - 1 - 1 / (levels - 1)


def answers_given(u: Scalar, cuts: Float[Array, " levels_less_1"], kappa: Scalar) -> Float[Array, " levels"]:
    """Probability of each level where the difference is u, perceived with a logistic error."""
    below = jax.nn.sigmoid((cuts - u) / kappa)
    return jnp.diff(below, prepend=0.0, append=1.0)


def phi_of(T: Trajectories, features: AdditiveFeatures, clips: Clip, config: QuestionConfig) -> Float[Array, "clips D"]:
    """Sum of φ over each clip, less their mean, which says nothing of a difference and would take float32's digits."""
    H = T.rows.actions.shape[1]
    Phi = clip_sums(features, T, clips, H if config.clip is None else min(config.clip, H))
    there = T.filled[clips.of][:, None]
    return Phi - jnp.sum(jnp.where(there, Phi, 0.0), axis=0, keepdims=True) / jnp.maximum(jnp.sum(there), 1)


def apart(x: Float[Array, "..."], shown: Int[Array, "n items"]) -> Float[Array, "n items_less_1 ..."]:
    """X of each clip that a question shows less that of the last; of a single clip, beside the mean, as it is."""
    each = x[shown]
    return each if shown.shape[1] == 1 else each[:, :-1] - each[:, -1:]


def _distinct(clips: Clip, worth: Float[Array, " n"]) -> Float[Array, " n"]:
    """The worth of questions, those that show the same steps twice ruled out."""
    return jnp.where(twice(clips) | ~jnp.isfinite(worth), -jnp.inf, worth)


def twice(clips: Clip) -> Bool[Array, " n"]:
    """Whether the clips in each row show the same steps twice."""
    m = clips.of.shape[1]
    same = clips.of[:, :, None] == clips.of[:, None]
    apart = jnp.abs(clips.start[:, :, None] - clips.start[:, None])
    overlap = same & (apart < jnp.minimum(clips.length[:, :, None], clips.length[:, None]))
    return jnp.any(overlap & ~jnp.eye(m, dtype=bool)[None], axis=(1, 2))
