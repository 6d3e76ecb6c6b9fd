"""Plan(s; f̃, r̂): what is executed in s, given the policy that the search found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from hiprl.control.imagined import Ends, SearchState, goes_on
from hiprl.errors import InputError
from hiprl.hallucinated import Hallucinated
from hiprl.types import Action, Actor, Key, Policy, Reward, Scalar, State

Plan: TypeAlias = Literal["none", "sample", "mpc"]
"""How a policy is executed: without noise (`none`), drawn from (`sample`, the paper), or improved at every step by
planning ahead in the model (`mpc`)."""
PLANS: tuple[Plan, ...] = get_args(Plan)


@dataclass(frozen=True, kw_only=True)
class PlanConfig:
    """How actions are chosen at act time."""

    kind: Plan = "none"
    """One of `none`, `sample`, `mpc`."""
    noise: float = 0.1
    """Standard deviation of what is added to each executed action, in [-1, 1], while it learns; nothing is added when a
    policy is confirmed and reported."""
    proposals: int = 64
    """Sequences of (a, η) compared in one iteration (mpc)."""
    elites: int = 8
    """Best sequences, around which the next iteration looks."""
    iterations: int = 3
    """Rounds of proposals."""
    horizon: int = 8
    """Steps planned ahead; the value stands for what follows."""
    spread: float = 0.3
    """Standard deviation of the first round around the policy's own sequence; actions are in [-1, 1]."""

    def __post_init__(self) -> None:
        if not 0 <= self.noise < 1:
            raise InputError(
                f"got a noise of {self.noise} for actions that are in [-1, 1]; it is at least 0 and less than 1. "
                "Take 0.1, or 0 to execute the policy as it is."
            )
        if self.kind not in PLANS or not 1 <= self.elites <= self.proposals:
            raise InputError(
                f"got the plan {self.kind!r} with {self.elites} elites of {self.proposals} proposals; a plan is one of "
                f"{', '.join(PLANS)}, with at least 1 elite and at most as many as proposals. Change what does not fit."
            )


class Follow(Actor):
    """Executes a policy's action and leaves out its hallucinated control."""

    policy: Policy
    q: int = eqx.field(static=True)
    explore: bool = eqx.field(static=True)
    """Draw from the policy, or take its mode."""

    def act(self, s: State, *, key: Key) -> Action:
        action_and_eta = self.policy.sample(s, key=key) if self.explore else self.policy.mode(s)
        return action_and_eta[: self.q]


class Noisy(Actor):
    """Does nearly what another would do.

    A policy without noise can come to rest where it is stuck, and repeat one state and one action for the rest of an
    episode: the model never sees what else could have been done there, and believes that the policy gets away.
    """

    actor: Actor
    noise: float = eqx.field(static=True)

    def act(self, s: State, *, key: Key) -> Action:
        act_key, noise_key = jr.split(key)
        a = self.actor.act(s, key=act_key)
        return jnp.clip(a + self.noise * jr.normal(noise_key, a.shape), -1.0, 1.0)


class Mpc(Actor):
    """Improves the policy's sequence of (a, η) in the hallucinated model, and executes its first a.

    The cross-entropy method around the policy's own imagined rollout, which is itself among the proposals: in the
    model, the plan is never worse than the policy.
    """

    state: SearchState
    f_tilde: Hallucinated
    reward: Reward
    ends: Ends | None
    config: PlanConfig = eqx.field(static=True)
    gamma: float = eqx.field(static=True)

    def act(self, s: State, *, key: Key) -> Action:
        config = self.config
        model_key, propose_key = jr.split(key)
        draws = jr.normal(model_key, (config.horizon, s.shape[0]))  # the same for all: proposals differ in (a, η) only

        def follow(s: State, draw: State):
            u = self.state.policy.mode(s)
            return self.f_tilde.step(s, u, draw=draw, value=self.state.value)[0], u

        _, own = jax.lax.scan(follow, s, draws)

        def worth(sequence: Float[Array, "h size"]) -> Scalar:
            def step(carry: tuple[State, Scalar], now: tuple[Float[Array, " size"], State]):
                s, weight = carry
                u, draw = now
                s_next, bonus = self.f_tilde.step(s, u, draw=draw, value=self.state.value)
                a, _ = self.f_tilde.split(u)
                on = goes_on(self.ends, s, a, s_next)
                return (s_next, weight * self.gamma * on), weight * (self.reward(s, a) + bonus)

            (s_end, weight), r = jax.lax.scan(step, (s, jnp.ones(())), (sequence, draws))
            return jnp.sum(r) + weight * self.state.value(s_end)

        def improve(carry, key: Key):
            mean, spread, best, best_worth = carry
            noise = jr.normal(key, (config.proposals, *mean.shape))
            proposals = jnp.clip(mean[None] + spread[None] * noise, -1.0, 1.0).at[0].set(mean)
            scores = jax.vmap(worth)(proposals)
            top, rows = jax.lax.top_k(scores, config.elites)
            elites = proposals[rows]
            better = top[0] > best_worth
            best = jnp.where(better, elites[0], best)
            next_spread = jnp.std(elites, axis=0) + 0.01
            return (jnp.mean(elites, axis=0), next_spread, best, jnp.maximum(top[0], best_worth)), None

        carry = (own, jnp.full_like(own, config.spread), own, jnp.asarray(-jnp.inf))
        (_, _, best, _), _ = jax.lax.scan(improve, carry, jr.split(propose_key, config.iterations))
        return self.f_tilde.split(best[0])[0]


def planned(
    state: SearchState,
    f_tilde: Hallucinated,
    reward: Reward,
    ends: Ends | None,
    config: PlanConfig,
    *,
    q: int,
    gamma: float,
) -> Actor:
    """The actor that executes what a search found, in the way that the config names."""
    if config.kind == "mpc":
        return Mpc(state, f_tilde, reward, ends, config, gamma)
    return Follow(state.policy, q, config.kind == "sample")
