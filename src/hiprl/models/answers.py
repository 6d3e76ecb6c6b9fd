"""EstReward(P, T), eq. (7), from answers of any kind: one posterior for numbers, levels, choices, rankings and ratings.

A judge perceives differences against what was at hand: what is much better among stumbles is nothing among runs. So the
unit in which an answer's level is read is the spread of r̂ over the clips that were at hand when it was given, and r̂
and these units are found in turn. Numbers are in the judge's own unit, which does not change.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.preference import Kind, Preferences, Said
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.features import AdditiveFeatures
from hiprl.models.likelihood import Noise, for_each, responsibility
from hiprl.models.reward import AdditiveReward, additive_reward, clip_sums, evidence, most_steps
from hiprl.models.sums import every_step, sums, values
from hiprl.models.variational import Answers, Belief, evidence_of, improved, posterior_of, thin, unknown
from hiprl.types import Count, Flag, Scalar

JUDGES = 16
"""Judges whose mistakes are told apart; further ones count as the last."""
ROUNDS = 4  # at most, of finding units and mistakes for the reward, and the reward for these
SAME = 0.05  # relative change of units and mistakes below which the next round would find nothing new
STEPS, ENOUGH = 10, 0.1  # Newton steps for a candidate at most, and the gain in nats of one that is the last
POLISH = 20, 1e-3  # the same for the candidate that is kept
COLUMNS = 3  # of the prior's factor, for each coordinate: leave out at most 3e-4 of a value's variance
COLUMNS_OF_NUMBERS = 4  # the same where there are numbers, whose errors are small: 1e-5
STARTS = 32  # clips of a trajectory over which its spread is taken
SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)  # candidates for the size of a typical difference, where a whole scale is 1
NEAREST = (-1, 0, 1)  # moves among the candidates once all of them were tried
SURENESS = 2.0  # factor by which a typical difference may well be another size than a whole scale
BENT = 1.0  # nats that each tenfold greater share of the smooth part has to earn: few answers tell no curves
KAPPAS = (0.03, 0.1, 0.3)  # candidates for κ where levels have two bounds; else only the ratio to the scale counts
KAPPA = 0.1
NUMBER_ERROR = 1e-4  # variance of a number's error, over what the prior gives a number, where kinds are mixed
OFFSET = 0.25  # variance of where a judge sees the middle of a rating
MISTAKE, TRUST = 0.02, 20.0  # how often a judge errs, and how many answers this belief is worth
LEAST_UNIT = 1e-3  # of an answer, in that of the newest one


class Errors(NamedTuple):
    """How the judges were found to err."""

    kappa: Scalar
    """Scale of the error of perception, where a whole scale is 1."""
    mistakes: Float[Array, " judges"]
    """Share of answers that mean something else."""
    scale: Scalar
    """Size of r̂'s unit, where a whole scale is 1 at the time of the newest answer."""


class Problem(NamedTuple):
    """All that the posterior depends on."""

    Psi: Float[Array, "K J D"]
    said: Said
    filled: Bool[Array, " K"]
    judge: Int[Array, " K"]
    priors: Float[Array, "S D"]
    """Candidates for the prior variance of θ; each gives a typical answer the variance 1."""
    number_unit: Float[Array, " S"]
    """What a number is divided by, for each of these."""


At: TypeAlias = Int[Array, "3"]
"""Which candidate for the scale, for the prior, and for κ."""


class Found(NamedTuple):
    """The best so far."""

    at: At
    belief: Belief


class Round(NamedTuple):
    """Where the search for scales, units and mistakes is."""

    number: Count
    moved: Flag
    """The last round changed something."""
    unit: Float[Array, " K"]
    """What a whole scale was at each answer, over that at the newest."""
    mistakes: Float[Array, " judges"]
    found: Found


def estimate_from_answers(
    P: Preferences, T: Trajectories, smooth: tuple[float, ...], *, learn_mistakes: bool = False
) -> tuple[AdditiveReward, Errors]:
    """Posterior of the additive reward given answers of any kind, its scales chosen by marginal likelihood.

    Args:
        P: the answers.
        T: the trajectories they are about.
        smooth: candidates for the variance of the smooth part over that of the linear part.
        learn_mistakes: how often each judge errs is found too; there have to be repeated questions or several judges
            to tell.

    Source: HIP-RL eq. (7); `hiprl.models.variational`.
    """
    features, Psi = compared(T, P)
    kinds = kinds_in(P)
    levels = P.filled & (P.said.kind != Kind.NUMBER) & jnp.isfinite(P.said.low) & jnp.isfinite(P.said.high)
    kappas = KAPPAS if bool(jnp.any(levels & (P.said.kind != Kind.RANKING))) else (KAPPA,)
    X = every_step(features, T)
    priors = jax.vmap(features.prior)(jnp.ones(len(smooth)), jnp.asarray(smooth))
    with jax.enable_x64(True):
        wide = lambda x: jnp.asarray(x, jnp.float64)
        said = Said(P.said.kind, wide(P.said.low), wide(P.said.high), P.said.items)
        numbers = Kind.NUMBER in kinds
        problem = _problem(wide(Psi), said, P.filled, P.judge, wide(priors), numbers=numbers)
        more = {"smooth": smooth, "kappas": kappas, "learn_mistakes": learn_mistakes, "numbers": numbers}
        posterior, errors = _posterior(problem, features, T, P, X, lengths_of(P), **more)
        posterior, errors = jax.tree.map(lambda x: x.astype(jnp.float32), (posterior, errors))
    return additive_reward(T, features, *posterior, errors.scale, errors.kappa), errors


def kinds_in(P: Preferences) -> set[Kind]:
    """Kinds of the answers there are. Not to be traced."""
    return {Kind(int(kind)) for kind in np.asarray(P.said.kind)[: int(P.count)]}


def compared(T: Trajectories, P: Preferences) -> tuple[AdditiveFeatures, Float[Array, "K J D"]]:
    """Features of T, and Ψ: what each answer compares, ratings included. Not to be traced."""
    steps = most_steps(P, T)
    features, Psi = evidence(T, P, steps=steps)
    return features, _with_ratings(features, T, P, Psi, longest=steps) if Kind.RATING in kinds_in(P) else Psi


@partial(jax.jit, static_argnames=("longest",))
def _with_ratings(features: AdditiveFeatures, T: Trajectories, P: Preferences, Psi, *, longest: int):
    """Ψ with a row for each rating: its clip against as many average steps of what was at hand."""
    X, mask = every_step(features, T), jax.vmap(Trajectory.transitions)(T.rows).mask
    Phi = sums(features, X, mask)
    clips = jax.tree.map(lambda x: x[:, 0], P.clips)
    steps = jnp.clip(T.rows.length[clips.of] - clips.start, 0, clips.length)

    def average(at_hand: Count) -> Float[Array, " D"]:
        there = (jnp.arange(T.capacity) < at_hand) & T.filled
        count = jnp.maximum(jnp.sum(jnp.where(there, T.rows.length, 0)), 1)
        return jnp.sum(jnp.where(there[:, None], Phi, 0.0), axis=0) / count

    shown = clip_sums(features, T, clips, longest)
    against = shown - steps[:, None] * jax.vmap(average)(P.at_hand)
    rated = P.filled & (P.said.kind == Kind.RATING)
    return Psi.at[:, 0].set(jnp.where(rated[:, None], against, Psi[:, 0]))


@partial(jax.jit, static_argnames=("numbers",))
def _problem(Psi, said: Said, filled, judge, priors, *, numbers: bool) -> Problem:
    """The same in units in which a typical answer has variance 1."""
    n = jnp.maximum(jnp.sum(filled), 1)
    level = jnp.einsum("kjd,sd->s", Psi**2, priors) / n
    priors = priors / jnp.where(level > 0, level, 1.0)[:, None]
    if not numbers:
        return Problem(Psi, said, filled, judge, priors, jnp.ones(len(priors), Psi.dtype))
    those = filled & (said.kind == Kind.NUMBER)
    g, count = jnp.where(those, said.low, 0.0), jnp.sum(those)

    def unit(prior):
        A = jnp.where(those[:, None], Psi[:, 0], 0.0)
        K = (A * prior[None]) @ A.T + jnp.diag(jnp.where(those, NUMBER_ERROR, 1.0))
        size = g @ jnp.linalg.solve(K, g) / jnp.maximum(count, 1)
        return jnp.where(size > 0, jnp.sqrt(size), 1.0)

    return Problem(Psi, said, filled, judge, priors, jax.vmap(unit)(priors))


def lengths_of(P: Preferences) -> Int[Array, " L"]:
    """Each length that first clips have, once, and some twice, so that few programs serve all. Not to be traced."""
    lengths = np.unique(np.asarray(P.clips.length[:, 0]))
    return jnp.asarray(np.resize(lengths, 1 << (len(lengths) - 1).bit_length()))


def units(r: Float[Array, "N H"], T: Trajectories, P: Preferences, lengths: Int[Array, " L"]) -> Float[Array, " K"]:
    """Spread of r̂ over the clips at hand at each answer, over that at the newest one.

    Args:
        r: r̂ at each step.
        T: the trajectories.
        P: the answers.
        lengths: what `lengths_of` gives.
    """
    real = jax.vmap(Trajectory.transitions)(T.rows).mask
    C = jnp.pad(jnp.cumsum(jnp.where(real, r, 0.0), axis=1), ((0, 0), (1, 0)))
    i = jnp.arange(T.capacity)
    there = ((i[None] < P.at_hand[:, None]) & T.filled[None]).astype(r.dtype)
    count = STARTS * jnp.maximum(jnp.sum(there, axis=1), 1)

    def spread(length: Count) -> Float[Array, " K"]:
        n = jnp.minimum(length, T.rows.length)[:, None]
        latest = T.rows.length[:, None] - n
        t = (latest * jnp.arange(STARTS)[None]) // (STARTS - 1)
        shown = jnp.where(T.filled[:, None], C[i[:, None], t + n] - C[i[:, None], t], 0.0)
        own = jnp.mean(shown, axis=1)  # of each trajectory
        within = jnp.sum((shown - own[:, None]) ** 2, axis=1)
        middle = STARTS * (there @ own) / count
        between = jnp.sum(there * (own[None] - middle[:, None]) ** 2, axis=1)
        return jnp.sqrt((there @ within + STARTS * between) / count)

    which = jnp.argmax(lengths[None] == P.clips.length[:, :1], axis=1)
    found = jax.lax.map(spread, lengths)[which, jnp.arange(P.capacity)]
    newest = found[jnp.maximum(P.count - 1, 0)]
    return jnp.where(newest > 0, jnp.maximum(found / newest, LEAST_UNIT), 1.0)


@partial(jax.jit, static_argnames=("smooth", "kappas", "learn_mistakes", "numbers"))
def _posterior(
    problem: Problem,
    features: AdditiveFeatures,
    T: Trajectories,
    P: Preferences,
    X: Float[Array, "n steps"],
    lengths: Int[Array, " L"],
    *,
    smooth,
    kappas,
    learn_mistakes,
    numbers,
):
    """Mean, prior variance and root of θ for the best scales, and how the judges err.

    The scales are found one after the other: at first along all candidates for one with the others as they are, then
    among the nearest ones, until neither they nor the units of the answers change. Each search goes on from the belief
    of the one before, so that a few of Newton's steps do: an error of the belief counts by its square alone.
    """
    Psi, said, filled, judge, priors, number_unit = problem
    K, J, D = Psi.shape
    number = said.kind == Kind.NUMBER
    judge = jnp.minimum(judge, JUDGES - 1)
    rated = filled & (said.kind == Kind.RATING)
    told = filled & ~number
    values_of = [jnp.asarray(x, Psi.dtype) for x in (SCALES, smooth, kappas)]
    sizes = jnp.asarray([len(x) for x in values_of])
    long = jnp.asarray([i for i, x in enumerate(values_of) if len(x) > len(NEAREST)])
    axes = jnp.asarray([i for i, x in enumerate(values_of) if len(x) > 1])
    bent = BENT * jnp.log10(values_of[1] / min(smooth))

    flat = Psi.reshape(K * J, D)
    rank = min(K * J, D, (COLUMNS_OF_NUMBERS if numbers else COLUMNS) * (features.low.shape[0] + 1))
    thins = jax.vmap(lambda prior: thin((flat * prior[None]) @ flat.T, rank))(priors)
    first = jnp.zeros((K, J)).at[:, 0].set(jnp.where(rated, OFFSET, 0.0)).reshape(-1)
    offset = jnp.sqrt(first)[:, None]  # of all ratings
    mask = jax.vmap(Trajectory.transitions)(T.rows).mask

    def weights(at: At, unit: Float[Array, " K"]):
        """What puts each row of Ψ into the unit of its answer."""
        return jnp.repeat(jnp.where(number, 1.0, values_of[0][at[0]] / unit), J)

    def seen(at: At, unit: Float[Array, " K"], mistakes: Float[Array, " judges"]) -> tuple[Array, Answers]:
        """Factor of the prior covariance of the values, and the answers in their units."""
        A = number_unit[at[1]]
        scaled = Said(said.kind, jnp.where(number, said.low / A, said.low), said.high, said.items)
        noise = Noise(values_of[2][at[2]], jnp.asarray(NUMBER_ERROR, Psi.dtype), mistakes[judge])
        factor = jnp.concatenate([weights(at, unit)[:, None] * thins[at[1]], offset], axis=1)
        return factor, Answers(scaled, filled, noise)

    def carried(belief: Belief, before: Array, now: Array) -> Belief:
        """The same belief about θ, in other units."""
        return belief._replace(dual=belief.dual * (before / now) ** 2)

    def along(unit, mistakes, moves: Int[Array, " moves"], found: Found, axis: Count) -> tuple[Found, None]:
        """The best candidate along one axis."""

        def tried(move: Count):
            i = jnp.clip(found.at[axis] + move, 0, sizes[axis] - 1)
            at = found.at.at[axis].set(i)
            A, given = seen(at, unit, mistakes)
            belief = carried(found.belief, weights(found.at, unit), weights(at, unit))
            belief = improved(A, given, belief, steps=STEPS, enough=ENOUGH)
            score = evidence_of(A, given, belief) - jnp.sum(filled & number) * jnp.log(number_unit[at[1]])
            score += -0.5 * (jnp.log(values_of[0][at[0]]) / jnp.log(SURENESS)) ** 2 - bent[at[1]]
            return Found(at, belief), jnp.where(jnp.isfinite(score), score, -jnp.inf)

        line, scores = jax.vmap(tried)(moves)
        return jax.tree.map(lambda x: x[jnp.argmax(scores)], line), None

    def erring(found: Found, unit, mistakes):
        if not learn_mistakes:
            return mistakes
        A, given = seen(found.at, unit, mistakes)
        f = (A @ (A.T @ found.belief.dual)).reshape(K, J)
        wrong = for_each(responsibility, f, given.said, given.noise)
        total = jnp.zeros(JUDGES).at[judge].add(jnp.where(told, wrong, 0.0))
        count = jnp.zeros(JUDGES).at[judge].add(jnp.where(told, 1.0, 0.0))
        return (total + MISTAKE * TRUST) / (count + TRUST)

    def mean_of(found: Found, unit):
        at = found.at
        return number_unit[at[1]] * priors[at[1]] * (flat.T @ (weights(at, unit) * found.belief.dual))

    def one_round(before: Round) -> Round:
        unit, mistakes = before.unit, before.mistakes
        found, _ = jax.lax.scan(partial(along, unit, mistakes, jnp.asarray(NEAREST)), before.found, axes)
        return judged(before, found)

    def judged(before: Round, found: Found) -> Round:
        """Units and mistakes by what was found."""
        unit, mistakes = before.unit, before.mistakes
        r = values(features, X, mean_of(found, unit).astype(X.dtype)).reshape(mask.shape)
        now, wrong = units(r, T, P, lengths).astype(Psi.dtype), erring(found, unit, mistakes)
        apart = jnp.maximum(far(jnp.where(filled, now / unit, 1.0)), far(wrong / mistakes))
        moved = jnp.any(found.at != before.found.at) | (apart > SAME)
        belief = carried(found.belief, weights(found.at, unit), weights(found.at, now))
        return Round(before.number + 1, moved, now, wrong, Found(found.at, belief))

    def far(ratio: Array) -> Scalar:
        return jnp.max(jnp.abs(jnp.log(ratio)))

    at = jnp.asarray([len(x) // 2 for x in values_of])
    unit, mistakes = jnp.ones(K), jnp.full(JUDGES, MISTAKE)
    found = Found(at, unknown(seen(at, unit, mistakes)[0], K))
    reach = max(len(x) for x in values_of) // 2
    line = jnp.arange(-reach, reach + 1)
    found, _ = jax.lax.scan(partial(along, unit, mistakes, line), found, long)
    start = judged(Round(jnp.ones((), jnp.int32), jnp.asarray(True), unit, mistakes, found), found)
    go_on = lambda now: now.moved & (now.number <= ROUNDS)
    end = jax.lax.while_loop(go_on, one_round, start._replace(moved=jnp.asarray(True)))
    unit, mistakes, found = end.unit, end.mistakes, end.found
    A, given = seen(found.at, unit, mistakes)
    found = Found(found.at, improved(A, given, found.belief, steps=POLISH[0], enough=POLISH[1]))
    unit_of, prior, weight = number_unit[found.at[1]], priors[found.at[1]], weights(found.at, unit)
    whole = jnp.concatenate([weight[:, None] * flat * jnp.sqrt(prior)[None], offset], axis=1)
    root = unit_of * ((posterior_of(whole, given, found.belief).root * weight[None]) @ flat) * prior[None]
    errors = Errors(given.noise.kappa, erring(found, unit, mistakes), values_of[0][found.at[0]] / unit_of)
    return (mean_of(found, unit), unit_of**2 * prior, root), errors
