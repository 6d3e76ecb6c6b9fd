"""EstReward(P, T), eq. (7), from answers of any kind: one posterior for numbers, levels, choices, rankings and ratings.

A judge perceives differences against what was at hand: what is much better among stumbles is nothing among runs. So the
unit in which an answer's level is read is the spread of r̂ over the clips that were at hand when it was asked for, and
r̂ and these units are found in turn. Numbers are in the judge's own unit, which does not change.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from hiprl.data.preference import Kind, Preferences, Said
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.evidence import Evidence, evidence, kinds_in
from hiprl.models.features import Kernel, priors_of
from hiprl.models.likelihood import Noise, for_each, responsibility
from hiprl.models.relevance import OF_ANSWERS, relevance_of, shares_of, spread_by
from hiprl.models.reward import (
    JUDGES,
    AdditiveReward,
    Errors,
    additive_reward,
    believed,
)
from hiprl.models.units import lengths_of, units
from hiprl.models.variational import Answers, Belief, begun, improved, left_out, posterior_of, thin, unknown
from hiprl.types import Count, Scalar

ROUNDS = 9  # at most, of finding units, mistakes and relevance for the reward, and the reward for these
SAME = 0.05  # relative change of these below which the next round would find nothing new
STEPS, ENOUGH = 20, 0.3  # Newton steps for a candidate at most, and the gain in nats of one that is the last
POLISH = 20, 1e-3  # the same for the candidate that is kept
COLUMNS, FULL = 2, 3  # of the prior's factor, for each coordinate, while kernels are weighed up, and for the one kept
LEAST_COLUMNS = 32  # of any: what is short and rough takes more columns than a state of few entries suggests
COLUMNS_OF_NUMBERS, FULL_OF_NUMBERS = 4, 6  # the same where there are numbers, whose errors are small
SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)  # candidates for the size of a typical difference, where a whole scale is 1
USUAL = math.sqrt(2)  # size of the difference of two clips drawn at random, where their spread is 1
SURENESS = 2.0  # factor by which a typical difference may well be another size than a whole scale
BENT = 1.0  # nats that each tenfold greater share of the smooth part has to earn: few answers tell no curves
KAPPAS = (0.03, 0.1, 0.3)  # candidates for κ where levels have two bounds; else only the ratio to the scale counts
KAPPA = 0.1
NUMBER_ERROR = 1e-4  # variance of a number's error, over what the prior gives a number, where kinds are mixed
OFFSET = 0.25  # variance of where a judge sees the middle of a rating
MISTAKE, TRUST = 0.02, 20.0  # how often a judge errs, and how many answers this belief is worth


At: TypeAlias = Int[Array, "3"]
"""Which candidate for the scale, for the kernel, and for κ."""


class Problem(NamedTuple):
    """All that the posterior depends on."""

    Psi: Float[Array, "K J D"]
    said: Said
    filled: Bool[Array, " K"]
    judge: Int[Array, " K"]
    priors: Float[Array, "kernels D"]
    """The prior variance of θ for each kernel, before any entry is more relevant than another."""
    log_prior: Float[Array, " kernels"]
    """How much each kernel is believed in, in nats."""
    kappas: Float[Array, " kappas"]

    @property
    def number(self) -> Bool[Array, " K"]:
        """Answers that are numbers."""
        return self.said.kind == Kind.NUMBER

    @property
    def offset(self) -> Float[Array, "KJ 1"]:
        """What all ratings have in common, as a column of the prior's factor."""
        K, J, _ = self.Psi.shape
        rated = self.filled & (self.said.kind == Kind.RATING)
        first = jnp.zeros((K, J), self.Psi.dtype).at[:, 0].set(jnp.where(rated, OFFSET**0.5, 0.0))
        return first.reshape(-1)[:, None]

    def weights(self, scale: Scalar, unit: Float[Array, " K"]) -> Float[Array, " KJ"]:
        """What puts each row of Ψ into the unit of its answer."""
        return jnp.repeat(jnp.where(self.number, 1.0, scale / unit), self.Psi.shape[1])

    def prior(self, i: Count, relevance: Float[Array, " entries"]) -> Float[Array, " D"]:
        """The prior variance of θ under kernel i, in units in which a typical answer has variance 1."""
        prior = spread_by(self.priors[i], relevance)
        level = jnp.sum(jnp.sum(self.Psi**2, axis=(0, 1)) * prior) / jnp.maximum(jnp.sum(self.filled), 1)
        return prior / jnp.where(level > 0, level, 1.0)

    def number_unit(self, prior: Float[Array, " D"]) -> Scalar:
        """What a number is divided by: the size that explains the numbers best."""
        those = self.filled & self.number
        g, A = jnp.where(those, self.said.low, 0.0), jnp.where(those[:, None], self.Psi[:, 0], 0.0)
        K = (A * prior[None]) @ A.T + jnp.diag(jnp.where(those, NUMBER_ERROR, 1.0))
        size = g @ jnp.linalg.solve(K, g) / jnp.maximum(jnp.sum(those), 1)
        return jnp.where(size > 0, jnp.sqrt(size), 1.0)

    def answers(self, at: At, number_unit: Scalar, mistakes: Float[Array, " judges"]) -> Answers:
        """The answers in their units."""
        low = jnp.where(self.number, self.said.low / number_unit, self.said.low)
        noise = Noise(self.kappas[at[2]], jnp.asarray(NUMBER_ERROR, low.dtype), mistakes[self.judge])
        return Answers(Said(self.said.kind, low, self.said.high, self.said.items), self.filled, noise)


class Under(NamedTuple):
    """The values that were compared, under one kernel."""

    factor: Float[Array, "KJ rank"]
    """A with AAᵀ their prior covariance, before each is put into the unit of its answer."""
    number: Scalar
    """What a number is divided by."""


class Found(NamedTuple):
    """The best so far."""

    at: At
    under: Under
    belief: Belief
    score: Scalar
    """Log marginal likelihood and prior."""
    line: Float[Array, " scales"]
    """The same along the scales."""


class Look(IntEnum):
    """Which candidates a round looks at."""

    ALL = 0
    SAME = 1
    """None but the one found."""
    NEAR = 2
    """Those beside it."""
    NONE = 3
    """The search is over."""


class Round(NamedTuple):
    """Where the search for scales, units and mistakes is."""

    number: Count
    look: Count
    """A `Look`."""
    unit: Float[Array, " K"]
    """What a whole scale was at each answer, over that at the newest."""
    mistakes: Float[Array, " judges"]
    relevance: Float[Array, " entries"]
    """Prior variance of each entry's function, over the mean of all."""
    found: Found


def estimate_from_answers(
    P: Preferences, T: Trajectories, kernels: tuple[Kernel, ...], *, learn_mistakes: bool = False
) -> AdditiveReward:
    """Posterior of the additive reward given answers of any kind, its scales chosen by marginal likelihood.

    Args:
        P: the answers.
        T: the trajectories they are about.
        kernels: candidates for the smooth part.
        learn_mistakes: how often each judge errs is found too; there have to be repeated questions or several judges
            to tell.

    Source: HIP-RL eq. (7); `hiprl.models.variational`.
    """
    kinds = kinds_in(P)
    kappas = KAPPAS if _two_bounds(P) else (KAPPA,)
    seen = evidence(T, P)
    entries = seen.features.low.shape[0] + 1
    variance, length = np.asarray(kernels).T
    log_prior = believed(kernels) - BENT * np.log10(variance / variance.min())
    middle = len(SCALES) // 2, int(np.sum(length == length.max())) // 2, len(kappas) // 2
    finest = int(np.sum(length == length.min()))  # so many further on is the next length, of the same variance
    numbers = Kind.NUMBER in kinds
    with jax.enable_x64(True):
        wide = in_64_bits((seen.Psi, P.said, priors_of(seen.features, kernels)))
        judge = jnp.minimum(P.judge, JUDGES - 1)
        problem = Problem(wide[0], wide[1], P.filled, judge, wide[2], jnp.asarray(log_prior), jnp.asarray(kappas))
    with jax.enable_x64(numbers):  # whose errors are small
        end = _search(
            problem if numbers else in_32_bits(problem),
            seen,
            T,
            P,
            lengths_of(P),
            jnp.asarray(middle),
            columns=max(LEAST_COLUMNS, (COLUMNS_OF_NUMBERS if numbers else COLUMNS) * entries),
            steps=(-1, 1, -finest, finest),
            learn_mistakes=learn_mistakes,
            numbers=numbers,
        )
    with jax.enable_x64(True):
        posterior, errors = in_32_bits(
            _posterior(
                problem,
                in_64_bits(end),
                columns=max(LEAST_COLUMNS, (FULL_OF_NUMBERS if numbers else FULL) * entries),
                numbers=numbers,
            )
        )
    if numbers:
        errors = errors._replace(spread=jnp.zeros(()))  # a number has a unit of its own
    return additive_reward(T, seen, *posterior, errors)


def _two_bounds(P: Preferences) -> bool:
    """Whether any answer says of a difference that it is between two others. Not to be traced."""
    kind, low, high = (np.asarray(x)[: int(P.count)] for x in (P.said.kind, P.said.low, P.said.high))
    return bool(np.any((kind != Kind.NUMBER) & (kind != Kind.RANKING) & np.isfinite(low) & np.isfinite(high)))


@jax.jit
def in_64_bits(x: PyTree) -> PyTree:
    """The same with float64 for float32."""
    return jax.tree.map(lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, x)


@jax.jit
def in_32_bits(x: PyTree) -> PyTree:
    """The same with float32 for float64."""
    return jax.tree.map(lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x, x)


def visits_of(
    sizes: tuple[int, ...], steps: tuple[int, ...]
) -> tuple[Int[np.ndarray, "visits 3"], Int[np.ndarray, "looks 2"]]:
    """What can be looked at: an axis, where to on it, and whether that is from here; and each `Look`'s part of it.

    Each begins with the one found, which another one has to better.

    Args:
        sizes: candidates on each axis.
        steps: between kernels that are beside one another.
    """
    axes = [axis for axis, n in enumerate(sizes) if n > 1]
    every = [(axis, to, 0) for axis in axes for to in range(sizes[axis])]
    same = [(0, 0, 1)]
    near = every[: sizes[0]] + [(axis, to, 1) for axis in axes[1:] for to in (steps if axis == 1 else (-1, 1))]
    looks = same + every, same, same + near
    ends = np.cumsum([0, *map(len, looks)])
    return np.concatenate(looks), np.stack([ends[:-1], ends[1:]], axis=1)


@partial(jax.jit, static_argnames=("columns", "steps", "learn_mistakes", "numbers"))
def _search(
    problem: Problem,
    seen: Evidence,
    T: Trajectories,
    P: Preferences,
    lengths: Int[Array, " L"],
    middle: At,
    *,
    columns: int,
    steps: tuple[int, ...],
    learn_mistakes: bool,
    numbers: bool,
) -> Round:
    """The best scales, the units of the answers, how the judges err, and what they go by.

    The scales are found one after the other: at first along all candidates for one with the others as they are, and
    once units, mistakes and relevance have settled, among the nearest ones, until nothing changes. Each candidate goes
    on from the belief of the best before it, so that a few of Newton's steps do: an error of the belief counts by its
    square alone.
    """
    K, J, D = problem.Psi.shape
    told = problem.filled & ~problem.number
    sizes = len(SCALES), len(problem.priors), len(problem.kappas)
    visits, looks = map(jnp.asarray, visits_of(sizes, steps))
    mask = jax.vmap(Trajectory.transitions)(T.rows).mask
    flat = problem.Psi.reshape(K * J, D)

    def weights(at: At, unit: Float[Array, " K"]) -> Float[Array, " KJ"]:
        return problem.weights(jnp.asarray(SCALES, flat.dtype)[at[0]], unit)

    def under(i: Count, relevance: Float[Array, " entries"]) -> Under:
        prior = problem.prior(i, relevance)
        number = problem.number_unit(prior) if numbers else jnp.ones((), flat.dtype)
        return Under(factor_of(flat, prior, columns), number)

    def in_units(at: At, kernel: Under, now: Round) -> tuple[Float[Array, "KJ rank"], Answers]:
        """Factor of the prior covariance of the values, each in the unit of its answer, and the answers."""
        A = jnp.concatenate([weights(at, now.unit)[:, None] * kernel.factor, problem.offset], axis=1)
        return A, problem.answers(at, kernel.number, now.mistakes)

    def tried(before: Round, visit: Int[Array, "3"], found: Found) -> Found:
        """What was found, or another candidate if it is better."""
        axis, to, nearby = visit
        i = jnp.clip(jnp.where(nearby, found.at[axis] + to, to), 0, jnp.asarray(sizes)[axis] - 1)
        at = found.at.at[axis].set(i)
        kernel = jax.lax.cond(axis == 1, lambda: under(i, before.relevance), lambda: found.under)
        A, given = in_units(at, kernel, before)
        ratio = weights(found.at, before.unit) / weights(at, before.unit)
        belief = carried(found.belief, ratio**2)  # so that the values stay as they are
        belief = improved(A, given, belief, steps=STEPS, enough=ENOUGH)
        score = belief.evidence + left_out(A, given, belief) + problem.log_prior[at[1]]
        score -= jnp.sum(problem.filled & problem.number) * jnp.log(kernel.number)
        score -= 0.5 * (jnp.log(jnp.asarray(SCALES, score.dtype)[at[0]] / USUAL) / math.log(SURENESS)) ** 2
        line = jnp.where(axis == 0, found.line.at[i].set(score), found.line)
        new, old = Found(at, kernel, belief, score, line), found._replace(line=line)
        return jax.tree.map(partial(jnp.where, score > found.score), new, old)

    def erring(A: Float[Array, "KJ rank"], given: Answers, belief: Belief) -> Float[Array, " judges"]:
        f = (A @ (A.T @ belief.dual)).reshape(K, J)
        wrong = for_each(responsibility, f, given.said, given.noise)
        nobody = jnp.zeros(JUDGES, wrong.dtype)
        total = nobody.at[problem.judge].add(jnp.where(told, wrong, 0.0))
        return (total + MISTAKE * TRUST) / (nobody.at[problem.judge].add(told) + TRUST)

    def one_round(before: Round) -> Round:
        """The best candidate, and units, mistakes and relevance by what was found."""
        unit, mistakes, relevance = before.unit, before.mistakes, before.relevance
        kernel, none = under(before.found.at[1], relevance), jnp.full_like(before.found.score, -jnp.inf)
        belief = begun(*in_units(before.found.at, kernel, before), before.found.belief)
        start = before.found._replace(under=kernel, score=none, belief=belief)
        begin, end = looks[before.look]
        found = jax.lax.fori_loop(begin, end, lambda i, found: tried(before, visits[i], found), start)
        prior, weight = problem.prior(found.at[1], relevance), weights(found.at, unit)
        A, given = in_units(found.at, found.under, before)
        mean = prior * (flat.T @ (weight * found.belief.dual))  # but for the unit of numbers, which changes no ratio
        root = ((posterior_of(A, given, found.belief).root * weight[None]) @ flat) * prior[None]
        r = seen.values(mean.astype(seen.X.dtype)).reshape(mask.shape)
        now = units(r, T, P, lengths, jnp.maximum(P.count - 1, 0)).astype(unit.dtype)
        shares = shares_of(mean, prior, root, relevance)  # at one scale of a few, which is not the likeliest size
        relevant = relevance_of(shares / jnp.mean(shares), freedom=OF_ANSWERS)
        wrong = erring(A, given, found.belief) if learn_mistakes else mistakes
        apart = jnp.maximum(far(jnp.where(problem.filled, now / unit, 1.0)), far(wrong / mistakes))
        apart = jnp.maximum(apart, far((1 + relevant) / (1 + relevance)))  # what is silent may change by a lot
        number, near = before.number + 1, before.look == Look.NEAR
        moved = jnp.where(near, jnp.any(found.at != before.found.at), apart > SAME) & (number < ROUNDS)
        look = jnp.where(moved, Look.SAME, jnp.where(near, Look.NONE, Look.NEAR)).astype(number.dtype)
        belief = carried(found.belief, weight / weights(found.at, now))  # so that θ stays as it is
        after = Round(number, look, now, wrong, relevant, found._replace(belief=belief))
        over = Round(number, look, unit, mistakes, relevance, found)  # the best under these, not under the next
        return jax.tree.map(partial(jnp.where, look == Look.NONE), over, after)

    def far(ratio: Array) -> Scalar:
        return jnp.max(jnp.abs(jnp.log(ratio)))

    nowhere, unit = jnp.full(1 + len(SCALES), -jnp.inf, flat.dtype), jnp.ones(K, flat.dtype)
    relevance = jnp.ones_like(seen.features.low, flat.dtype)
    mistakes = jnp.full(JUDGES, MISTAKE, flat.dtype)
    kernel = under(middle[1], relevance)
    found = Found(middle, kernel, unknown(kernel.factor, K), nowhere[0], nowhere[1:])
    zero = jnp.zeros((), jnp.int32)
    start = Round(zero, zero + Look.ALL, unit, mistakes, relevance, found)
    return jax.lax.while_loop(lambda now: now.look != Look.NONE, one_round, start)


def carried(belief: Belief, ratio: Float[Array, " KJ"]) -> Belief:
    """The belief with its dual times this, for values in other units."""
    return belief._replace(dual=belief.dual * ratio)


@partial(jax.jit, static_argnames=("columns", "numbers"))
def _posterior(problem: Problem, end: Round, *, columns: int, numbers: bool):
    """Mean, prior variance and root of θ for the scales that were found, and how the judges err."""
    at, _, belief, _, line = end.found
    flat, prior = problem.Psi.reshape(-1, problem.Psi.shape[2]), problem.prior(at[1], end.relevance)
    unit = problem.number_unit(prior) if numbers else jnp.ones((), flat.dtype)
    scale, spread = top_of(line)
    weight, given = problem.weights(scale, end.unit), problem.answers(at, unit, end.mistakes)
    seen = lambda factor: jnp.concatenate([weight[:, None] * factor, problem.offset], axis=1)
    belief = carried(belief, (problem.weights(jnp.asarray(SCALES, flat.dtype)[at[0]], end.unit) / weight) ** 2)
    belief = improved(seen(factor_of(flat, prior, columns)), given, belief, steps=POLISH[0], enough=POLISH[1])
    of = posterior_of(seen(flat * jnp.sqrt(prior)[None]), given, belief)
    root = unit * ((of.root * weight[None]) @ flat) * prior[None]
    mean = unit * prior * (flat.T @ (weight * belief.dual))
    errors = Errors(problem.kappas[at[2]], end.mistakes, scale / unit, spread)
    return (mean, unit**2 * prior, root), errors


def top_of(line: Float[Array, " scales"]) -> tuple[Scalar, Scalar]:
    """The likeliest scale, and the standard deviation of its logarithm, by the parabola through the three best."""
    logs = jnp.log(jnp.asarray(SCALES, line.dtype))
    i = jnp.clip(jnp.argmax(line), 1, len(SCALES) - 2)
    x, y = (jax.lax.dynamic_slice_in_dim(z, i - 1, 3) for z in (logs, line))
    a, b, _ = jnp.linalg.solve((x - x[1])[:, None] ** jnp.array([[2, 1, 0]]), y - y[1])
    bend = jnp.maximum(-2 * a, 1 / math.log(SURENESS) ** 2)  # the prior alone bends it so much
    return jnp.exp(x[1] + jnp.clip(b / bend, x[0] - x[1], x[2] - x[1])), 1 / jnp.sqrt(bend)


def factor_of(flat: Float[Array, "n D"], prior: Float[Array, " D"], columns: int) -> Float[Array, "n rank"]:
    """A with AAᵀ = Ψ P Ψᵀ, but for what so many columns leave out."""
    return thin((flat * prior[None]) @ flat.T, min(*flat.shape, columns))
