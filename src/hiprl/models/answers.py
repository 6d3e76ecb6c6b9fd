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
from jaxtyping import Array, Bool, Float, Int

from hiprl.data.preference import Kind, Preferences, Said
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.features import AdditiveFeatures
from hiprl.models.likelihood import Noise, for_each, responsibility
from hiprl.models.reward import AdditiveReward, additive_reward, evidence, most_steps, summed
from hiprl.models.variational import Answers, Belief, evidence_of, improved, posterior_of, unknown
from hiprl.types import Count, Scalar

JUDGES = 16
"""Judges whose mistakes are told apart; further ones count as the last."""
ROUNDS = 3  # of finding units and mistakes for the reward, and the reward for these
NEWTON, POLISH = 4, 10  # Newton steps for each candidate, and for the one that is kept
STARTS = 32  # clips of a trajectory over which its spread is taken
SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)  # candidates for the size of a typical difference, where a whole scale is 1
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
    features, Psi = evidence(T, P, steps=most_steps(P, T))
    kinds = {Kind(int(kind)) for kind in P.said.kind[: int(P.count)]}
    if Kind.RATING in kinds:
        Psi = _with_ratings(features, T, P, Psi)
    levels = P.filled & (P.said.kind != Kind.NUMBER) & jnp.isfinite(P.said.low) & jnp.isfinite(P.said.high)
    kappas = KAPPAS if bool(jnp.any(levels & (P.said.kind != Kind.RANKING))) else (KAPPA,)
    priors = jax.vmap(features.prior)(jnp.ones(len(smooth)), jnp.asarray(smooth))
    with jax.enable_x64(True):
        wide = lambda x: jnp.asarray(x, jnp.float64)
        said = Said(P.said.kind, wide(P.said.low), wide(P.said.high), P.said.items)
        problem = _problem(wide(Psi), said, P.filled, P.judge, wide(priors))
        more = {"smooth": smooth, "kappas": kappas, "learn_mistakes": learn_mistakes}
        posterior, errors = _posterior(problem, features, T, P, **more)
        posterior, errors = jax.tree.map(lambda x: x.astype(jnp.float32), (posterior, errors))
    return additive_reward(T, features, *posterior, errors.scale, errors.kappa), errors


@jax.jit
def _with_ratings(features: AdditiveFeatures, T: Trajectories, P: Preferences, Psi):
    """Ψ with a row for each rating: its clip against as many average steps of what was at hand."""
    sums = jax.vmap(summed, in_axes=(None, 0))(features, T.rows)
    clips = jax.tree.map(lambda x: x[:, 0], P.clips)
    steps = jnp.clip(T.rows.length[clips.of] - clips.start, 0, clips.length)

    def average(at_hand: Count) -> Float[Array, " D"]:
        there = (jnp.arange(T.capacity) < at_hand) & T.filled
        count = jnp.maximum(jnp.sum(jnp.where(there, T.rows.length, 0)), 1)
        return jnp.sum(jnp.where(there[:, None], sums, 0.0), axis=0) / count

    shown = jax.vmap(lambda clip: summed(features, T.clip(clip)))(clips)
    against = shown - steps[:, None] * jax.vmap(average)(P.at_hand)
    rated = P.filled & (P.said.kind == Kind.RATING)
    return Psi.at[:, 0].set(jnp.where(rated[:, None], against, Psi[:, 0]))


@jax.jit
def _problem(Psi, said: Said, filled, judge, priors) -> Problem:
    """The same in units in which a typical answer has variance 1."""
    n = jnp.maximum(jnp.sum(filled), 1)
    level = jnp.einsum("kjd,sd->s", Psi**2, priors) / n
    priors = priors / jnp.where(level > 0, level, 1.0)[:, None]
    numbers = filled & (said.kind == Kind.NUMBER)
    g, count = jnp.where(numbers, said.low, 0.0), jnp.sum(numbers)

    def unit(prior):
        A = jnp.where(numbers[:, None], Psi[:, 0], 0.0)
        K = (A * prior[None]) @ A.T + jnp.diag(jnp.where(numbers, NUMBER_ERROR, 1.0))
        size = g @ jnp.linalg.solve(K, g) / jnp.maximum(count, 1)
        return jnp.where(size > 0, jnp.sqrt(size), 1.0)

    return Problem(Psi, said, filled, judge, priors, jax.vmap(unit)(priors))


def units(features: AdditiveFeatures, mean: Float[Array, " D"], T: Trajectories, P: Preferences) -> Float[Array, " K"]:
    """Spread of r̂ over the clips at hand at each answer, over that at the newest one."""
    rows = jax.vmap(Trajectory.transitions)(T.rows)
    r = jax.vmap(jax.vmap(lambda s, a: features.dot(s, a, mean)))(rows.s, rows.a)
    C = jnp.pad(jnp.cumsum(jnp.where(rows.mask, r, 0.0), axis=1), ((0, 0), (1, 0)))
    i = jnp.arange(T.capacity)[:, None]

    def spread(length: Count, at_hand: Count) -> Scalar:
        n = jnp.minimum(length, T.rows.length)[:, None]
        latest = T.rows.length[:, None] - n
        t = (latest * jnp.arange(STARTS)[None]) // (STARTS - 1)
        sums = C[i, t + n] - C[i, t]
        there = (i < at_hand) & T.filled[:, None]
        count = jnp.maximum(jnp.sum(there) * STARTS, 1)
        middle = jnp.sum(jnp.where(there, sums, 0.0)) / count
        return jnp.sqrt(jnp.sum(jnp.where(there, (sums - middle) ** 2, 0.0)) / count)

    found = jax.vmap(spread)(P.clips.length[:, 0], P.at_hand)
    newest = found[jnp.maximum(P.count - 1, 0)]
    return jnp.where(newest > 0, jnp.maximum(found / newest, LEAST_UNIT), 1.0)


@partial(jax.jit, static_argnames=("smooth", "kappas", "learn_mistakes"))
def _posterior(
    problem: Problem, features: AdditiveFeatures, T: Trajectories, P: Preferences, *, smooth, kappas, learn_mistakes
):
    """Mean, prior variance and root of θ for the best scales, and how the judges err.

    The scales are found one after the other, each along all its candidates with the others as they are; each search
    goes on from the belief of the one before, so that a few of Newton's steps do.
    """
    Psi, said, filled, judge, priors, number_unit = problem
    K, J, D = Psi.shape
    number = said.kind == Kind.NUMBER
    judge = jnp.minimum(judge, JUDGES - 1)
    rated = filled & (said.kind == Kind.RATING)
    told = filled & ~number
    values = [jnp.asarray(x, Psi.dtype) for x in (SCALES, smooth, kappas)]
    sizes = jnp.asarray([len(x) for x in values])
    axes = jnp.asarray([i for i, x in enumerate(values) if len(x) > 1])
    bent = BENT * jnp.log10(values[1] / min(smooth))

    flat = Psi.reshape(K * J, D)
    grams = jax.vmap(lambda prior: (flat * prior[None]) @ flat.T)(priors)
    first = jnp.zeros((K, J)).at[:, 0].set(jnp.where(rated, 1.0, 0.0)).reshape(-1)
    offset = OFFSET * jnp.outer(first, first)

    def weights(at: At, unit: Float[Array, " K"]):
        """What puts each row of Ψ into the unit of its answer."""
        return jnp.repeat(jnp.where(number, 1.0, values[0][at[0]] / unit), J)

    def seen(at: At, unit: Float[Array, " K"], mistakes: Float[Array, " judges"]) -> tuple[Array, Answers]:
        """Prior covariance of the values, and the answers in their units."""
        weight, A = weights(at, unit), number_unit[at[1]]
        scaled = Said(said.kind, jnp.where(number, said.low / A, said.low), said.high, said.items)
        noise = Noise(values[2][at[2]], jnp.asarray(NUMBER_ERROR, Psi.dtype), mistakes[judge])
        return grams[at[1]] * jnp.outer(weight, weight) + offset, Answers(scaled, filled, noise)

    def carried(belief: Belief, before: Array, now: Array) -> Belief:
        """The same belief about θ, in other units."""
        return belief._replace(dual=belief.dual * (before / now) ** 2)

    def along(unit, mistakes, found: Found, axis: Count) -> tuple[Found, None]:
        """The best candidate along one axis."""

        def tried(i: Count):
            at = found.at.at[axis].set(jnp.minimum(i, sizes[axis] - 1))
            K_at, given = seen(at, unit, mistakes)
            belief = carried(found.belief, weights(found.at, unit), weights(at, unit))
            belief = improved(K_at, given, belief, steps=NEWTON)
            score = evidence_of(K_at, given, belief) - jnp.sum(filled & number) * jnp.log(number_unit[at[1]])
            score += -0.5 * (jnp.log(values[0][at[0]]) / jnp.log(SURENESS)) ** 2 - bent[at[1]]
            return Found(at, belief), jnp.where(jnp.isfinite(score), score, -jnp.inf)

        line, scores = jax.vmap(tried)(jnp.arange(max(len(x) for x in values)))
        return jax.tree.map(lambda x: x[jnp.argmax(scores)], line), None

    def erring(found: Found, unit, mistakes):
        if not learn_mistakes:
            return mistakes
        K_at, given = seen(found.at, unit, mistakes)
        wrong = for_each(responsibility, (K_at @ found.belief.dual).reshape(K, J), given.said, given.noise)
        total = jnp.zeros(JUDGES).at[judge].add(jnp.where(told, wrong, 0.0))
        count = jnp.zeros(JUDGES).at[judge].add(jnp.where(told, 1.0, 0.0))
        return (total + MISTAKE * TRUST) / (count + TRUST)

    def mean_of(found: Found, unit):
        at = found.at
        return number_unit[at[1]] * priors[at[1]] * (flat.T @ (weights(at, unit) * found.belief.dual))

    def one_round(carry, _):
        unit, mistakes, found = carry
        found, _ = jax.lax.scan(partial(along, unit, mistakes), found, axes)
        now = units(features, mean_of(found, unit).astype(jnp.float32), T, P).astype(Psi.dtype)
        belief = carried(found.belief, weights(found.at, unit), weights(found.at, now))
        return (now, erring(found, unit, mistakes), Found(found.at, belief)), None

    at = jnp.asarray([len(x) // 2 for x in values])
    unit, mistakes = jnp.ones(K), jnp.full(JUDGES, MISTAKE)
    start = Found(at, unknown(seen(at, unit, mistakes)[0], K))
    (unit, mistakes, found), _ = jax.lax.scan(one_round, (unit, mistakes, start), length=ROUNDS)
    K_at, given = seen(found.at, unit, mistakes)
    found = Found(found.at, improved(K_at, given, found.belief, steps=POLISH))
    A, prior, weight = number_unit[found.at[1]], priors[found.at[1]], weights(found.at, unit)
    root = A * ((posterior_of(K_at, given, found.belief).root * weight[None]) @ flat) * prior[None]
    errors = Errors(given.noise.kappa, erring(found, unit, mistakes), values[0][found.at[0]] / A)
    return (mean_of(found, unit), A**2 * prior, root), errors
