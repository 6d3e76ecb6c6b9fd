"""What was seen, and what each answer compares: all that the posterior of an additive reward is made from."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from hiprl.data.preference import Clip, Kind, Preferences
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.features import AdditiveFeatures, Fine, by_entry, by_turn, size_of
from hiprl.models.network import Scaler
from hiprl.models.sums import Steps, added_up, by_row, columns, evenly, side_by_side, steps_of, total, turns
from hiprl.types import Count

BOX_MARGIN = 0.25  # how far past the seen range a coordinate, and the reward itself, may count
EDGE = 1.0  # spreads from the middle, past which values count no more than there
OF_NORMAL = 1 - math.sqrt(2 / (math.e * math.pi))  # variance of a standard normal so cut
CLOSER = 20  # rounds of finding middle and spread: half of the values may be far away
LEAST_SPREAD = 0.3  # in standard deviations: an entry that mostly stands still is not taken to pieces there
TOGETHER, PART = 8, 512  # clips, and steps, whose features are made at a time: what stays near the processor


@jax.jit
def features_of(steps: Steps) -> AdditiveFeatures:
    """Features standardised over those of these steps that were executed, with the box of them, a margin added."""
    x, mask = steps.x, steps.executed
    alone = jax.vmap(lambda x: Scaler.of(x[:, None], mask))(x)
    scaler = jax.tree.map(lambda each: each[:, 0], alone)
    least = scaler.down(jnp.min(jnp.where(mask[None], x, jnp.inf), axis=1))
    most = scaler.down(jnp.max(jnp.where(mask[None], x, -jnp.inf), axis=1))
    margin = BOX_MARGIN * (most - least)
    some, there = evenly(mask)  # a mean of many does not need them all
    low, high, nothing = least - margin, most + margin, jnp.zeros(size_of(x.shape[0]), x.dtype)
    fine = Fine.of(most_of(by_row(scaler).down(x[:, some]), there), low, high)
    features = AdditiveFeatures(scaler, low, high, fine, nothing)
    each = lambda x: total(features, columns(features, x[0]), x[1])
    whole = jnp.sum(jax.lax.map(each, (in_parts(x[:, some]), in_parts(there[None])[:, 0])), axis=0)
    centre = (whole / jnp.maximum(whole[0], 1)).at[0].set(0.0)
    return eqx.tree_at(lambda f: f.centre, features, centre)


def most_of(x: Float[Array, "n steps"], there: Bool[Array, " steps"]) -> Scaler:
    """Middle and spread of each row, where values far away count as much as those at the edge of what is usual.

    Source: Huber (1964), proposal 2.
    """
    count = jnp.maximum(jnp.sum(there), 1)
    mean = lambda x: jnp.sum(jnp.where(there[None], x, 0.0), axis=1) / count

    def closer(_: Count, now: Scaler) -> Scaler:
        edge = jnp.clip(by_row(now).down(x), -EDGE, EDGE)
        middle = mean(edge)
        var = mean((edge - middle[:, None]) ** 2) / OF_NORMAL
        return Scaler(now.mean + now.std * middle, jnp.maximum(now.std * jnp.sqrt(var), LEAST_SPREAD))

    start = Scaler(jnp.zeros(x.shape[0], x.dtype), jnp.ones(x.shape[0], x.dtype))
    return jax.lax.fori_loop(0, CLOSER, closer, start)


def in_parts(x: Shaped[Array, "n steps"]) -> Shaped[Array, "parts n PART"]:
    """Some steps at a time, with zeros at the end."""
    x = jnp.pad(x, ((0, 0), (0, -x.shape[1] % PART)))
    return x.reshape(x.shape[0], -1, PART).swapaxes(0, 1)


def clip_sum(features: AdditiveFeatures, T: Trajectories, clip: Clip, steps: int) -> Float[Array, " D"]:
    """Sum of φ over a clip of at most `steps` steps; 0 for nobody's."""
    n = jnp.minimum(clip.length, jnp.maximum(T.rows.length[clip.of] - clip.start, 0))
    t = jnp.arange(steps)
    shown = (t < n) & (clip.of >= 0)
    at = jnp.where(shown, clip.start + t, 0)
    clean = lambda x: jnp.where(shown[:, None], x[clip.of, at], 0.0)  # the clip alone, not its whole trajectory
    return total(features, columns(features, side_by_side(clean(T.rows.states), clean(T.rows.actions))), shown)


def clip_sums(features: AdditiveFeatures, T: Trajectories, clips: Clip, steps: int) -> Float[Array, "clips D"]:
    """The same for each of a stack of clips, a few at a time."""
    return jax.lax.map(lambda clip: clip_sum(features, T, clip, steps), clips, batch_size=TOGETHER)


def most_steps(P: Preferences, T: Trajectories) -> int:
    """Steps of the longest clip in P, rounded up so that few programs serve all. Not to be traced."""
    H = T.rows.actions.shape[1]
    longest = int(np.max(np.asarray(P.clips.length)[: int(P.count)], initial=1))
    part = 1 << max(0, (longest - 1).bit_length() - 3)  # an eighth of the next power of two
    return min(H, -(-longest // part) * part)


class Evidence(NamedTuple):
    """What was seen, and what each answer compares."""

    features: AdditiveFeatures
    X: Float[Array, "n steps"]
    """Coordinates of all steps that T has room for."""
    turns: Float[Array, "n steps"]
    """Of the waves there."""
    Psi: Float[Array, "K J D"]
    """Ψ: the sum of φ over each clip of an answer less that over its last one."""

    def values(self, weights: Float[Array, " D"]) -> Float[Array, " steps"]:
        """φᵀ weights at each step."""
        return added_up(self.features, by_turn(self.X, self.turns, by_entry(weights).T[..., None]), weights)


def evidence(T: Trajectories, P: Preferences, *, longest: int | None = None) -> Evidence:
    """Features of T, and what they are of its steps and of what the answers in P compare, ratings included.

    Best not traced: put into one program, its parts would each put the steps side by side anew.

    Args:
        T: the trajectories.
        P: the answers about them.
        longest: steps of the longest clip, where all answers are known to be numbers; P is looked at if None.
    """
    every, rated = steps_of(T), longest is None and Kind.RATING in kinds_in(P)
    features, longest = features_of(every), longest or most_steps(P, T)
    Psi = _differences(features, T, P, steps=longest)
    if rated:
        Psi = _with_ratings(features, T, P, Psi, longest=longest)
    X = columns(features, every.x)
    return Evidence(features, X, turns(features, X), Psi)


@partial(jax.jit, static_argnames=("steps",))
def _differences(features: AdditiveFeatures, T: Trajectories, P: Preferences, *, steps: int) -> Float[Array, "K J D"]:
    Phi = clip_sums(features, T, jax.tree.map(lambda x: x.reshape(-1), P.clips), steps).reshape(*P.clips.of.shape, -1)
    last = jnp.take_along_axis(Phi, jnp.maximum(P.said.items - 1, 0)[:, None, None], axis=1)
    used = P.filled[:, None] & (jnp.arange(P.m - 1)[None] < P.said.items[:, None] - 1)
    return jnp.where(used[..., None], Phi[:, :-1] - last, 0.0)


def kinds_in(P: Preferences) -> set[Kind]:
    """Kinds of the answers there are. Not to be traced."""
    return {Kind(int(kind)) for kind in np.asarray(P.said.kind)[: int(P.count)]}


@partial(jax.jit, static_argnames=("longest",))
def _with_ratings(features: AdditiveFeatures, T: Trajectories, P: Preferences, Psi, *, longest: int):
    """Ψ with a row for each rating: its clip against the average clip, as long as it was to be, of what was at hand."""
    Phi = clip_sums(features, T, Clip.whole(jnp.arange(T.capacity)), T.rows.actions.shape[1])
    clips = jax.tree.map(lambda x: x[:, 0], P.clips)

    def average(at_hand: Count, length: Count) -> Float[Array, " D"]:
        there = (jnp.arange(T.capacity) < at_hand) & T.filled
        each = jnp.maximum(T.rows.length / jnp.maximum(length, 1), 1.0)  # an episode that ends before is a clip as well
        return there @ Phi / jnp.maximum(jnp.sum(jnp.where(there, each, 0.0)), 1.0)

    against = clip_sums(features, T, clips, longest) - jax.vmap(average)(P.at_hand, clips.length)
    rated = P.filled & (P.said.kind == Kind.RATING)
    return Psi.at[:, 0].set(jnp.where(rated[:, None], against, Psi[:, 0]))
