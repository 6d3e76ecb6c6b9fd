"""What every policy search shares: where it starts, what it gives, and the trial of a policy in imagination."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int

from hiprl.control.policy import ClippedPolicy, SquashedPolicy, Value
from hiprl.hallucinated import Hallucinated
from hiprl.models.network import Scaler
from hiprl.types import Action, Flag, Key, Policy, Reward, Scalar, State

DOUBT = 2.0  # times as far from their mean as they are: where members lie in a doubtful trial
SHAKE = 0.1  # standard deviation of the noise in actions there, as they carry while a run learns

Ends = Callable[[State, Action, State], Flag]
"""When an imagined episode terminates. A pytree, so that a learned rule does not recompile a search."""


def goes_on(ends: Ends | None, s: State, a: Action, s_next: State) -> Scalar:
    """1 while an episode goes on, 0 where it terminates; without a rule it never does."""
    return jnp.ones(()) if ends is None else jnp.where(ends(s, a, s_next), 0.0, 1.0)


def along(
    ends: Ends | None, s: Float[Array, "h M n p"], a: Float[Array, "h M n q"], s_next: Float[Array, "h M n p"]
) -> tuple[Float[Array, "h M n"], Float[Array, "h M n"]]:
    """For each step of imagined rollouts: whether the episode goes on after it, and whether it had gone on so far."""
    on = jnp.vectorize(partial(goes_on, ends), signature="(p),(q),(p)->()")(s, a, s_next)
    return on, jnp.cumprod(jnp.concatenate([jnp.ones_like(on[:1]), on[:-1]]), axis=0)


def rollouts(
    step: Callable[[Hallucinated, State, Any], tuple[State, Any]],
    worlds: Hallucinated,
    s_0: Float[Array, "M n p"],
    draws: Any,
    *,
    axis: int | None,
) -> Any:
    """What `step` gives besides the next state, along n rollouts in each of M worlds: time first, then M, then n.

    Args:
        step: from a world, a state and what is drawn for one step.
        worlds: a stack of M; with `axis` None one world, for all.
        s_0: where they begin.
        draws: for all steps, time first.
        axis: along which `worlds` are stacked.
    """
    in_all = jax.vmap(jax.vmap(step, in_axes=(None, 0, 0)), in_axes=(axis, 0, 0))
    return jax.lax.scan(lambda s, now: in_all(worlds, s, now), s_0, draws)[1]


class SearchState(eqx.Module):
    """What one search hands to the next."""

    policy: SquashedPolicy | ClippedPolicy
    value: Value


class SearchReport(NamedTuple):
    """What a search believes to have reached."""

    imagined: Scalar
    """Mean return by r̂ of the kept policy over the trial steps, over members and starts."""
    worst: Scalar
    """The same in the worst member."""
    finite: Flag
    """Whether every number stayed finite."""

    @classmethod
    def nothing(cls) -> SearchReport:
        """Of no search at all."""
        return cls(jnp.asarray(-jnp.inf), jnp.asarray(-jnp.inf), jnp.asarray(False))


def report_of(returns: Float[Array, "M n"]) -> SearchReport:
    """The summary of a trial."""
    by_member = jnp.mean(returns, axis=1)
    return SearchReport(jnp.mean(by_member), jnp.min(by_member), jnp.all(jnp.isfinite(by_member)))


class Starts(eqx.Module):
    """Where imagined rollouts may begin."""

    seen: Float[Array, "n p"]
    """Seen states, drawn afresh for each search; half of them are the world's own where it says what is anywhere."""
    first: Float[Array, "N p"]
    """States in which episodes began."""
    scaler: Scaler
    """Mean and spread of these states."""


class Chance(NamedTuple):
    """What of a trial is chance: policies are compared on the same, or the luckiest would win, and not the best."""

    s_0: Float[Array, "M n p"]
    draws: Float[Array, "steps M n p"]
    """Standard normal, for the noise of the world."""

    @classmethod
    def draw(cls, first: Float[Array, "N p"], *, M: int, n: int, steps: int, key: Key) -> Chance:
        """Of `n` trials in each of M worlds, from where episodes begin."""
        start_key, draw_key = jr.split(key)
        return cls(jr.choice(start_key, first, (M, n)), jr.normal(draw_key, (steps, M, n, first.shape[1])))


class Doubt(NamedTuple):
    """What of a doubtful trial is chance besides."""

    member: Int[Array, "steps M n"]
    """Which one the world is, at each step."""
    shake: Float[Array, "steps M n q"]
    """Added to the actions."""

    @classmethod
    def draw(cls, chance: Chance, *, q: int, key: Key) -> Doubt:
        """For the trials of `chance`, with q entries of action."""
        member_key, shake_key = jr.split(key)
        when = chance.draws.shape[:-1]
        return cls(jr.randint(member_key, when, 0, when[1]), SHAKE * jr.normal(shake_key, (*when, q)))


def trials(
    worlds: Hallucinated,
    policy: Policy,
    reward: Reward,
    ends: Ends | None,
    chance: Chance,
    *,
    axis: int | None = 0,
    value: Callable[[State], Scalar] | None = None,
) -> Float[Array, "M n"]:
    """Return by r̂, with the bonus if any, of as many steps as chance has, without exploration.

    Args:
        worlds: a stack of M, with some trials in each; with `axis` None one world, for all of them.
        policy: what acts.
        reward: r̂.
        ends: when an imagined episode terminates; None for never.
        chance: where the trials begin, and the noise on their way.
        axis: along which `worlds` are stacked.
        value: V, without which the mode `eta_sign` is greedy.
    """

    def step(world: Hallucinated, s: State, draw: State):
        u = policy.mode(s)
        s_next, bonus = world.step(s, u, draw=draw, value=value)
        return s_next, (s, world.split(u)[0], s_next, bonus)

    s, a, s_next, bonus = rollouts(step, worlds, chance.s_0, chance.draws, axis=axis)
    _, alive = along(ends, s, a, s_next)
    return jnp.sum(alive * (reward.of_steps(s, a) + bonus), axis=0)


def doubtful_trials(
    f_tilde: Hallucinated, policy: Policy, reward: Reward, ends: Ends | None, chance: Chance, doubt: Doubt
) -> Float[Array, "M n"]:
    """Return by r̂ where the world is another member at each step, all of them further apart, and the hand unsteady.

    Members agree on much that is wrong, and a policy that was searched in them has found it: what it gains must not
    hang on which of them is right for a whole episode.

    Args:
        f_tilde: the model whose members are meant; no mode that hopes.
        policy: what acts.
        reward: r̂.
        ends: when an imagined episode terminates; None for never.
        chance: where the trials begin, and the noise of the world on their way.
        doubt: which member it is, and the noise in actions.
    """

    def step(f_tilde: Hallucinated, s: State, now: tuple[State, Doubt]):
        draw, (i, off) = now
        a = jnp.clip(policy.mode(s) + off, -1.0, 1.0)
        each = jax.vmap(lambda member: member.predict(s, a))(f_tilde.dynamics.members())
        mu = jnp.mean(each.mu, axis=0)
        s_next = jnp.clip(mu + DOUBT * (each.mu[i] - mu) + each.noise[i] * draw, f_tilde.low, f_tilde.high)
        return s_next, (s, a, s_next)

    s, a, s_next = rollouts(step, f_tilde, chance.s_0, (chance.draws, doubt), axis=None)
    _, alive = along(ends, s, a, s_next)
    return jnp.sum(alive * reward.of_steps(s, a), axis=0)
