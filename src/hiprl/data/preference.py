"""A preference g(τ₁, τ₂; r), the clips that a question shows, and the set P of answers."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.answer import Answer
from hiprl.data.trajectory import Trajectory
from hiprl.types import Count, Scalar

WHOLE = 1 << 30
"""Length of a clip that lasts as long as its trajectory does."""
NOBODY = -1
"""In place of a trajectory's number where an answer has fewer clips than there is room for."""


def gap(tau: Trajectory, other: Trajectory) -> Scalar:
    """g(τ, τ′; r): by how much the true return of τ exceeds that of τ′. For scripted judges only.

    Source: HIP-RL section 2, "Trajectory Preference".
    """
    return tau.true_return - other.true_return


class Clip(eqx.Module):
    """Some steps of a trajectory of T, or a stack of clips; it ends where its trajectory does."""

    of: Int[Array, "..."]
    """Number of the trajectory."""
    start: Int[Array, "..."]
    """First step."""
    length: Int[Array, "..."]
    """Most steps."""

    @classmethod
    def whole(cls, of: Int[Array, "*n"] | int) -> Clip:
        """All of a trajectory, or of several."""
        return cls.at(of, 0, WHOLE)

    @classmethod
    def at(cls, of: Int[Array, "*#n"] | int, start: Int[Array, "*#n"] | int, length: Int[Array, "*#n"] | int) -> Clip:
        """These steps of a trajectory, or of several."""
        return cls(*jnp.broadcast_arrays(*(jnp.asarray(x, jnp.int32) for x in (of, start, length))))

    @jax.jit
    def each(self) -> tuple[Clip, ...]:
        """Those of a stack, one by one."""
        return tuple(Clip(*one) for one in zip(self.of, self.start, self.length, strict=True))


class Kind(IntEnum):
    """How the bounds of an answer are read."""

    NUMBER = 0
    LEVEL = 1
    RANKING = 2
    RATING = 3


KINDS = {"number": Kind.NUMBER, "ranking": Kind.RANKING, "rating": Kind.RATING}
"""Of the forms that are not a level."""


class Said(eqx.Module):
    """What an answer says of the utilities of its clips, in numbers; or a stack of answers."""

    kind: Int[Array, "..."]
    """One of `Kind`."""
    low: Float[Array, "..."]
    """Least perceived difference that fits the answer; the number itself for `NUMBER`."""
    high: Float[Array, "..."]
    """Greatest; may be infinite."""
    items: Int[Array, "..."]
    """How many clips it is about."""

    @classmethod
    def of(cls, answer: Answer) -> Said:
        """An answer in numbers."""
        low, high = answer.bounds()
        kind = KINDS.get(answer.form, Kind.LEVEL)
        ints = jnp.asarray(kind, jnp.int32), jnp.asarray(answer.items, jnp.int32)
        return cls(ints[0], jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32), ints[1])


class Given(NamedTuple):
    """An answer with what it is about, in plain values."""

    answer: Answer
    clips: Sequence[tuple[int, int, int]]
    """Trajectory, first step and most steps of each clip, as they were shown."""
    judge: int
    at_hand: int


class Preferences(eqx.Module):
    """P: answers with the clips they are about, in the order in which they came."""

    said: Said
    clips: Clip
    """(K, m): of a ranking the best one first; of two clips the first is better where g > 0."""
    judge: Int[Array, " K"]
    """Who answered, by number."""
    at_hand: Int[Array, " K"]
    """How many trajectories there were when the question was asked."""
    count: Count

    @classmethod
    def empty(cls, capacity: int, *, m: int = 2) -> Preferences:
        """P = ∅ with room for `capacity` answers about at most `m` clips each."""
        zeros = jnp.zeros(capacity, jnp.int32)
        bounds = jnp.zeros(capacity)
        clips = Clip(jnp.full((capacity, m), NOBODY, jnp.int32), *[jnp.zeros((capacity, m), jnp.int32)] * 2)
        return cls(Said(zeros, bounds, bounds, zeros), clips, zeros, zeros, jnp.zeros((), jnp.int32))

    @classmethod
    def of(cls, given: Sequence[Given], capacity: int, *, m: int = 2) -> Preferences:
        """P with these answers, at once."""
        clips = np.zeros((3, capacity, m), np.int32)
        clips[0] = NOBODY
        bounds, ints = np.zeros((2, capacity), np.float32), np.zeros((4, capacity), np.int32)
        for k, one in enumerate(given):
            answer = one.answer
            order = answer.value if isinstance(answer.value, tuple) else range(len(one.clips))
            clips[:, k, : len(one.clips)] = np.array([one.clips[i] for i in order]).T
            bounds[:, k] = answer.bounds()
            ints[:, k] = KINDS.get(answer.form, Kind.LEVEL), answer.items, one.judge, one.at_hand
        kind, items, judge, at_hand = jnp.asarray(ints)
        low, high = jnp.asarray(bounds)
        count = jnp.asarray(len(given), jnp.int32)
        return cls(Said(kind, low, high, items), Clip(*jnp.asarray(clips)), judge, at_hand, count)

    @property
    def capacity(self) -> int:
        return self.judge.shape[0]

    @property
    def m(self) -> int:
        """Most clips that an answer can be about."""
        return self.clips.of.shape[1]

    @property
    def filled(self) -> Bool[Array, " K"]:
        """True for the rows that hold an answer."""
        return jnp.arange(self.capacity) < self.count

    @property
    def g(self) -> Float[Array, " K"]:
        """The numbers given; what is said of other kinds of answers means nothing."""
        return self.said.low

    @property
    def first(self) -> Int[Array, " K"]:
        """Trajectory of the first clip."""
        return self.clips.of[:, 0]

    @property
    def second(self) -> Int[Array, " K"]:
        """Trajectory of the second clip."""
        return self.clips.of[:, 1]

    def asked(self) -> list[frozenset[tuple[int, int, int]]]:
        """What each answer is about: trajectory, first step and most steps of its clips. Not to be traced."""
        return [frozenset(clips) for clips in self.shown()]

    def shown(self) -> list[list[tuple[int, int, int]]]:
        """The clips of each answer in their order. Not to be traced."""
        n, items = int(self.count), np.asarray(self.said.items)
        each = np.stack([np.asarray(x)[:n] for x in (self.clips.of, self.clips.start, self.clips.length)], axis=-1)
        return [[tuple(clip) for clip in clips[: items[k]].tolist()] for k, clips in enumerate(each)]

    def only_numbers(self) -> bool:
        """Whether every answer is a number. Looks at the values, so not to be traced."""
        return not np.any(np.asarray(self.said.kind)[: int(self.count)] != Kind.NUMBER)

    def only(self, rows: np.ndarray) -> Preferences:
        """P with these answers alone, in a P of the same room."""
        order = np.concatenate([rows, np.setdiff1d(np.arange(self.capacity), rows)]).astype(int)
        taken = jax.tree.map(lambda x: x[order] if x.ndim else x, self)
        return eqx.tree_at(lambda P: P.count, taken, jnp.asarray(len(rows), jnp.int32))

    def add(self, g: Scalar, first: Count, second: Count) -> Preferences:
        """P ∪ {g(τ_first, τ_second)}, of whole trajectories. The caller sees to it that there is room."""
        said = Said(*(jnp.asarray(x) for x in (Kind.NUMBER, g, g, 2)))
        pair = [Clip.whole(first), Clip.whole(second)]
        return self.put(said, pair, at_hand=jnp.maximum(jnp.asarray(first), jnp.asarray(second)) + 1)

    @jax.jit
    def put(self, said: Said, clips: Sequence[Clip], *, judge: Count | int = 0, at_hand: Count) -> Preferences:
        """P with one more answer, about these clips. The caller sees to it that there is room."""
        k = self.count
        row = lambda all_, one: all_.at[k].set(jnp.asarray(one, all_.dtype))
        parts = {name: jnp.stack([getattr(clip, name) for clip in clips]) for name in ("of", "start", "length")}
        at = lambda all_, some: all_.at[k, : len(clips)].set(some.astype(all_.dtype))
        return Preferences(
            Said(*(row(getattr(self.said, name), getattr(said, name)) for name in ("kind", "low", "high", "items"))),
            Clip(**{name: at(getattr(self.clips, name), some) for name, some in parts.items()}),
            row(self.judge, judge),
            row(self.at_hand, at_hand),
            k + 1,
        )

    def answered(self, answer: Answer, clips: Sequence[Clip], *, judge: int = 0, at_hand: Count) -> Preferences:
        """P with what a judge said about these clips, in the order in which they were shown."""
        order = answer.value if isinstance(answer.value, tuple) else range(len(clips))
        return self.put(Said.of(answer), [clips[i] for i in order], judge=judge, at_hand=at_hand)
