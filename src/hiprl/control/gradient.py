"""Policy search by back-propagation through the model: short imagined rollouts, ended by a learned value.

One update imagines a batch of rollouts of a few steps in the hallucinated model, and moves the policy up the gradient
of its TD(λ) return; the value follows by regression to the returns of all steps. Rollouts begin at states that were
seen, or go on where others ended: the value must hold where the policy goes, too, or the policy climbs its errors.
Updates come in chunks. After each chunk the policy is tried for longer, from where episodes begin, in a world that is
less kind than any member of the belief, and the iterate that is best there is the one that is kept. An optimist keeps
the one that is best in the hallucinated model itself: most of what it hopes for would else never be executed.
Source: value gradients through a model (SVG, Heess et al. 2015; Dreamer, Hafner et al. 2020), eq. (6) of HIP-RL.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Float, Int

from hiprl.control.imagined import (
    Chance,
    Doubt,
    Ends,
    SearchReport,
    SearchState,
    Starts,
    along,
    doubtful_trials,
    report_of,
    rollouts,
    trials,
)
from hiprl.control.policy import SquashedPolicy, Value, unscaled
from hiprl.errors import InputError
from hiprl.hallucinated import Hallucinated
from hiprl.models.fit import descend, descent
from hiprl.models.network import FEW, Activation, Scaler
from hiprl.types import Count, Flag, Key, Reward, Scalar, State, stacked_size


@dataclass(frozen=True, kw_only=True)
class GradientConfig:
    """Settings of the search by back-propagation through the model."""

    hidden: tuple[int, ...] | None = None
    """Units of the hidden layers of policy and value; None for two layers of 128, or of 64 where a state has 8 entries
    at most."""
    activation: Activation = "elu"
    """Between layers of policy and value."""
    chunks: int = 8
    """Looks at the policy during one search, at most."""
    updates: int = 100
    """Policy updates between two looks."""
    rollouts: int = 50
    """Imagined rollouts an update, for each of the M members."""
    steps: int = 5
    """Of an imagined rollout; the value stands for what follows. Through more steps, gradients are mostly noise."""
    policy_rate: float = 3e-4
    """Learning rate of the policy (Adam)."""
    value_rate: float = 1e-3
    """Learning rate of the value (Adam)."""
    value_updates: int = 4
    """Updates of the value for each of the policy."""
    settling: int = 300
    """Updates of the value alone before the policy moves, in whole chunks: it is learned anew in each search, as model
    and r̂ are newer."""
    offset_rate: float = 0.1
    """Share of what the value is off by in all states alike that is mended with each update."""
    gamma: float | None = None
    """Discount a step; None for 1 - 2/H, between 0.99 and 0.995: long episodes need a longer sight."""
    lambda_: float = 1.0
    """TD(λ): 0 trusts the value after one step, 1 the whole imagined rollout."""
    entropy: float = 1e-3
    """Weight of the policy's entropy, in units of a typical reward."""
    target_rate: float = 0.02
    """Share by which the target value moves to the value, each update."""
    max_gradient: float = 1e-3
    """Norm to which the gradient of the return, in units of a typical one, is cut."""
    going_on: float = 0.5
    """Share of imagined rollouts that go on where one of the update before ended, unless the episode did."""
    from_start: float = 0.1
    """Share of the others that begin where episodes begin, not at any seen state."""
    trial_steps: int = 1000
    """Length of the longer trial after each chunk."""
    trial_starts: int = 8
    """Trials in each member."""

    def __post_init__(self) -> None:
        counts = ("chunks", "updates", "rollouts", "steps", "value_updates", "trial_steps", "trial_starts")
        wrong = [name for name in counts if getattr(self, name) < 1]
        if not 0 <= (self.gamma or 0) < 1:
            wrong.append("gamma")
        if wrong:
            raise InputError(
                f"got {', '.join(f'{name} = {getattr(self, name)}' for name in wrong)} for the search; counts of at "
                "least 1 and a discount from 0 to below 1 are needed, as a value is a sum without end. Leave out what "
                "you are not sure of."
            )

    def layers(self, p: int) -> tuple[int, ...]:
        """Units of the hidden layers, where a state has `p` entries."""
        usual = (64, 64) if p <= FEW else (128, 128)
        return usual if self.hidden is None else self.hidden

    def discount(self, H: int) -> float:
        """γ in episodes of at most H steps."""
        return min(max(1 - 2 / H, 0.99), 0.995) if self.gamma is None else self.gamma


def new_gradient(inputs: Scaler, size: int, config: GradientConfig, *, key: Key) -> SearchState:
    """A policy that does next to nothing, and a value that knows nothing."""
    policy_key, value_key = jr.split(key)
    layers = {"hidden": config.layers(inputs.size), "activation": config.activation}
    return SearchState(
        SquashedPolicy.draw(inputs, size, **layers, key=policy_key), new_value(inputs, config, key=value_key)
    )


def new_value(inputs: Scaler, config: GradientConfig, *, key: Key) -> Value:
    """One that knows nothing."""
    return Value.draw(inputs, hidden=config.layers(inputs.size), activation=config.activation, key=key)


class Learner(NamedTuple):
    """What an update changes."""

    policy: SquashedPolicy
    value: Value
    target: Value
    """Follows the value."""
    policy_state: optax.OptState
    value_state: optax.OptState
    s: Float[Array, "M n p"]
    """Where the last rollouts ended."""
    alive: Float[Array, "M n"]
    """1 where the episode goes on there."""


def gradient_search(
    f_tilde: Hallucinated,
    reward: Reward,
    unit: Scalar,
    ends: Ends | None,
    starts: Starts,
    state: SearchState,
    config: GradientConfig,
    *,
    H: int,
    setbacks: Count,
    key: Key,
) -> tuple[SearchState, SearchReport]:
    """The policy, and its η, that is best in the hallucinated model, eq. (6).

    Args:
        f_tilde: the hallucinated model.
        reward: r̂.
        unit: size of a typical reward, so that no setting depends on the judge's unit.
        ends: when an imagined episode terminates; None for never.
        starts: where rollouts begin.
        state: the policy to start from.
        H: most steps in an episode; a trial lasts no longer.
        setbacks: searches from `state` that went wrong in the world; after any, this one is half as long.
    """
    gamma = config.discount(H)
    scale = unit / (1 - gamma)
    policy = cast("SquashedPolicy", state.policy).rescaled(starts.scaler)
    trial_key, doubt_key, value_key, key = jr.split(key, 4)
    value = new_value(starts.scaler, config, key=value_key).rescaled(starts.scaler, scale)
    worlds, axis = f_tilde.worlds()
    M = stacked_size(f_tilde.dynamics.members())
    policy_opt = optax.chain(optax.clip_by_global_norm(config.max_gradient), optax.adam(config.policy_rate))
    value_opt = optax.adam(config.value_rate)

    shape = M, config.rollouts

    def imagine(policy: SquashedPolicy, target: Value, s_0: Float[Array, "M n p"], draws: tuple[Array, Array]):
        """States, TD(λ) returns, how much of each is V, and weights of imagined rollouts; where they end, alive or not.

        The returns carry the policy's gradient. Time comes first, then members, then rollouts.
        """

        # What one step needs of the one before, and no more: the rest is cheaper for all steps at once.
        def step(world: Hallucinated, s: State, now: tuple[Float[Array, " size"], State]):
            act_draw, f_draw = now
            u, log_prob = policy.with_log_prob(s, act_draw)
            s_next, bonus = world.step(s, u, draw=f_draw, value=target)
            return s_next, (s, world.split(u)[0], s_next, bonus - config.entropy * unit * log_prob)

        s, a, s_next, extra = rollouts(step, worlds, s_0, draws, axis=axis)
        r = reward.of_steps(s, a) + extra
        on, alive = along(ends, s, a, s_next)
        v_next = jnp.vectorize(target, signature="(p)->()")(s_next)

        def backward(after: tuple[Array, Array], now: tuple[Array, Array, Array]):
            r, on, v = now
            mixed = lambda v, after: gamma * on * ((1 - config.lambda_) * v + config.lambda_ * after)
            both = r + mixed(v, after[0]), mixed(1.0, after[1])
            return both, both

        last = v_next[-1], jnp.ones(shape)
        _, (returns, of_value) = jax.lax.scan(backward, last, (r, on, v_next), reverse=True)
        end = jax.lax.stop_gradient((s_next[-1], alive[-1] * on[-1]))
        return jax.lax.stop_gradient(s), returns, of_value, alive, end

    def draw_starts(learner: Learner, key: Key) -> Float[Array, "M n p"]:
        seen_key, first_key, which_key, on_key = jr.split(key, 4)
        seen = jr.choice(seen_key, starts.seen, shape)
        first = jr.choice(first_key, starts.first, shape)
        new = jnp.where(jr.bernoulli(which_key, config.from_start, (*shape, 1)), first, seen)
        on = jr.bernoulli(on_key, config.going_on, shape) & (learner.alive > 0)
        return jnp.where(on[..., None], learner.s, new)

    def update(learner: Learner, update_key: Key, *, moving: Flag):
        policy, value, target, policy_state, value_state, *_ = learner
        start_key, act_key, f_key = jr.split(update_key, 3)
        s_0 = draw_starts(learner, start_key)
        steps = (config.steps, *shape)
        draws = jr.normal(act_key, (*steps, policy.size)), jr.normal(f_key, (*steps, s_0.shape[-1]))

        # Of the first state alone: the later ones are the policy's own doing. The sum over all of them, as Dreamer has
        # it, pays for reaching good states once for each step before, and makes actions up to twice too strong.
        def policy_loss(policy: SquashedPolicy):
            seen = imagine(policy, target, s_0, draws)
            return -jnp.mean(seen[1][0]) / scale, seen

        def moved():
            gradient, seen = jax.grad(policy_loss, has_aux=True)(policy)
            return *descend(policy_opt, policy, unscaled(gradient), policy_state), seen

        def kept():
            return policy, policy_state, imagine(policy, target, s_0, draws)

        policy, policy_state, seen = jax.lax.cond(moving, moved, kept)
        s, returns, of_value, weight, end = seen
        flat_s, goal, weight = s.reshape(-1, s.shape[-1]), returns.reshape(-1) / scale, weight.reshape(-1)
        goal = jax.lax.stop_gradient(goal)

        def value_loss(value: Value, rows: Int[Array, " rows"]):
            error = jax.vmap(value)(flat_s[rows]) / scale - goal[rows]
            return jnp.sum(weight[rows] * error**2) / jnp.maximum(jnp.sum(weight[rows]), 1.0)

        def value_step(carry, rows):
            value, target, value_state = carry
            gradient = unscaled(jax.grad(value_loss)(value, rows))
            value, value_state = descend(value_opt, value, gradient, value_state)
            target = jax.tree.map(lambda t, v: t + config.target_rate * (v - t), target, value)
            return (value, target, value_state), None

        # minibatches interleave, so that each sees all steps and all members
        n = flat_s.shape[0] // config.value_updates * config.value_updates
        rows = jnp.arange(n).reshape(-1, config.value_updates).T
        (value, target, value_state), _ = jax.lax.scan(value_step, (value, target, value_state), rows)
        # What V is off by in all states alike, as when r̂ has another mean, shows in returns of a few steps at a few
        # hundredths of its size, and would take 1/(1 - γ) steps to go.
        error = jnp.sum(weight * (goal - jax.vmap(target)(flat_s) / scale))
        off = error / jnp.maximum(jnp.sum(weight * (1 - of_value.reshape(-1))), 1e-6 * weight.shape[0])
        value, target = (V.raised(config.offset_rate * off) for V in (value, target))
        return Learner(policy, value, target, policy_state, value_state, *end), None

    def score_of(learner: Learner) -> Scalar:
        if f_tilde.hopes:
            return jnp.mean(trials(f_tilde, learner.policy, reward, ends, chance, axis=None, value=learner.value))
        return jnp.mean(doubtful_trials(f_tilde, learner.policy, reward, ends, chance, doubt))

    # The value settles in the same program in which the policy moves: two would take longer to compile.
    def chunk(i: Count, carry):
        learner, best, best_score, key = carry
        key, update_key = jr.split(key)
        moving = i >= settling
        learner, _ = jax.lax.scan(partial(update, moving=moving), learner, jr.split(update_key, config.updates))
        score = jax.lax.cond(moving, score_of, lambda _: nothing, learner)
        better = jnp.isfinite(score) & (score > best_score)
        keep = lambda new, old: jnp.where(better, new, old)
        best = jax.tree.map(keep, SearchState(learner.policy, learner.value), best)
        return learner, best, keep(score, best_score), key

    nowhere = jnp.zeros((*shape, starts.seen.shape[1])), jnp.zeros(shape)
    learner = Learner(policy, value, value, descent(policy_opt, policy), descent(value_opt, value), *nowhere)
    length = min(config.trial_steps, H)
    chance = Chance.draw(starts.first, M=M, n=config.trial_starts, steps=length, key=trial_key)
    doubt = Doubt.draw(chance, q=policy.size, key=doubt_key)
    # Where the search begins is no candidate: it was executed, and to execute it again would teach nothing.
    nothing = jnp.asarray(-jnp.inf)
    # A policy near one that holds in the world is likelier to hold there: the model is at fault further away.
    settling = -(-config.settling // config.updates)
    chunks = jnp.maximum(config.chunks >> jnp.minimum(setbacks, 1), 1)
    _, best, score, _ = jax.lax.fori_loop(0, settling + chunks, chunk, (learner, state, nothing, key))
    report = report_of(trials(f_tilde.in_each_member(), best.policy, reward, ends, chance))
    return best, report._replace(finite=report.finite & jnp.isfinite(score))
