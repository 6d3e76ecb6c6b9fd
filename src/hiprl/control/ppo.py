"""Policy search by PPO over any imagined world: the paper's method, many rollouts at a time.

Follows Schulman et al. (2017) as Stable-Baselines3 has it: one spread for all states, advantages standardised in
each minibatch, one optimiser for policy and value. The samples of an iteration come from several imagined
rollouts side by side; each begins anew when it terminates or has lasted as long as an episode.
"""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Bool, Float

from hiprl.control.imagined import Chance, Ends, SearchReport, SearchState, Starts, goes_on, report_of, trials
from hiprl.control.policy import LOG_ROOT_2PI, ClippedPolicy, Value, log_normal, unscaled
from hiprl.errors import InputError
from hiprl.hallucinated import Hallucinated
from hiprl.models.fit import descend, descent
from hiprl.models.network import Activation, Scaler
from hiprl.types import Key, Reward, Scalar, stacked_size


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """Settings of PPO; the defaults are Table 2 (InvertedPendulum)."""

    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers of policy and value (Stable-Baselines3's own)."""
    activation: Activation = "tanh"
    """Between layers."""
    learning_rate: float = 2.5e-4
    """Of Adam."""
    n_steps: int = 500
    """Imagined steps an iteration."""
    rollouts: int = 20
    """Rollouts side by side among which `n_steps` is shared out."""
    batch_size: int = 256
    """Samples in a minibatch; the last one of an epoch holds what is left."""
    n_epochs: int = 5
    """Passes over the samples of an iteration."""
    gamma: float = 0.999
    """Discount a step."""
    gae_lambda: float = 0.9
    """Of generalised advantage estimation."""
    clip_range: float = 0.4
    """How far the ratio of probabilities may leave 1."""
    ent_coef: float = 1.5e-7
    """Weight of the entropy."""
    vf_coef: float = 0.2
    """Weight of the value's loss."""
    max_grad_norm: float = 0.3
    """Norm to which a gradient is cut."""
    total_timesteps: int = 100_000
    """Imagined steps a search."""
    trial_steps: int = 300
    """Length of the trial at the end."""
    trial_starts: int = 8
    """Trials in each member."""

    def __post_init__(self) -> None:
        if self.n_steps % self.rollouts:
            raise InputError(
                f"got {self.n_steps} steps an iteration and {self.rollouts} rollouts; the rollouts share the steps "
                f"evenly. Take a multiple of {self.rollouts} steps."
            )
        if 1 in (self.n_steps % self.batch_size, self.batch_size, self.n_steps):
            raise InputError(
                f"got {self.n_steps} steps an iteration in minibatches of {self.batch_size}, one of which has a single "
                "sample; advantages are divided by their standard deviation, which needs two. Take another batch size."
            )

    @property
    def length(self) -> int:
        """Steps of each rollout in one iteration."""
        return self.n_steps // self.rollouts

    def discount(self, H: int) -> float:
        """γ, whatever the horizon."""
        del H
        return self.gamma


def new_ppo(inputs: Scaler, size: int, config: PPOConfig, *, key: Key) -> SearchState:
    """A policy that acts at random around zero, and a value that knows nothing."""
    policy_key, value_key = jr.split(key)
    return SearchState(
        ClippedPolicy.draw(inputs, size, hidden=config.hidden, activation=config.activation, key=policy_key),
        Value.draw(inputs, hidden=config.hidden, activation=config.activation, key=value_key),
    )


class Samples(eqx.Module):
    """What one iteration imagined."""

    s: Float[Array, "*n p"]
    u: Float[Array, "*n size"]
    log_prob: Float[Array, "*n"]
    advantage: Float[Array, "*n"]
    ret: Float[Array, "*n"]


class Rollouts(eqx.Module):
    """Where the imagined rollouts stand."""

    s: Float[Array, "n p"]
    age: Float[Array, " n"]
    """Steps since the rollout began."""


def ppo_search(
    f_tilde: Hallucinated,
    reward: Reward,
    ends: Ends | None,
    starts: Starts,
    state: SearchState,
    config: PPOConfig,
    *,
    H: int,
    key: Key,
) -> tuple[SearchState, SearchReport]:
    """The policy, and its η, that PPO finds in the hallucinated model, eq. (6); starts from `state`.

    Args:
        f_tilde: the hallucinated model.
        reward: r̂.
        ends: when an imagined episode terminates; None for never.
        starts: where rollouts begin; PPO begins where episodes begin.
        state: policy and value of the search before.
        H: steps after which an imagined episode is cut (and bootstrapped).
    """
    adam = optax.adam(config.learning_rate, eps=1e-5)
    # over one long vector: the minibatches are small, and a step an array would cost as much as the products
    optimiser = optax.flatten(optax.chain(optax.clip_by_global_norm(config.max_grad_norm), adam))
    policy, value = state.policy.rescaled(starts.scaler), state.value.rescaled(starts.scaler, jnp.ones(()))
    worlds, axis = f_tilde.worlds()
    M = stacked_size(worlds) if axis == 0 else 1
    per_world = -(-config.rollouts // M)
    spare = M * per_world - config.rollouts

    def begin(key: Key, shape: tuple[int, ...]) -> Float[Array, "*shape p"]:
        return jr.choice(key, starts.first, shape)

    def step_each(worlds: Hallucinated, value: Value, s, u, draws):
        one = lambda world, s, u, draw: world.step(s, u, draw=draw, value=value)
        if axis is None:
            return jax.vmap(one, in_axes=(None, 0, 0, 0))(worlds, s, u, draws)
        # a share of the rollouts in each member; where they do not come out even, copies of the last one fill up
        even = lambda x: jnp.concatenate([x, jnp.broadcast_to(x[-1], (spare, *x.shape[1:]))])
        by_world = lambda x: even(x).reshape(M, per_world, *x.shape[1:])
        s, bonus = jax.vmap(jax.vmap(one, in_axes=(None, 0, 0, 0)))(worlds, by_world(s), by_world(u), by_world(draws))
        return s.reshape(M * per_world, -1)[: config.rollouts], bonus.reshape(-1)[: config.rollouts]

    def imagine(policy: ClippedPolicy, value: Value, rollouts: Rollouts, key: Key) -> tuple[Rollouts, Samples]:
        act_key, f_key, begin_key = jr.split(key, 3)
        n, p = rollouts.s.shape
        act_draws = jr.normal(act_key, (config.length, n, policy.log_std.shape[0]))
        f_draws = jr.normal(f_key, (config.length, n, p))
        first = begin(begin_key, (config.length, n))

        # What one step needs of the one before, and no more: the rest is cheaper for all steps at once.
        def step(now: Rollouts, draws):
            act_draw, f_draw, first = draws
            mean, log_std = jax.vmap(policy.gaussian, out_axes=(0, None))(now.s)
            u = mean + jnp.exp(log_std)[None] * act_draw
            box = jnp.clip(u, -1.0, 1.0)
            s_next, bonus = step_each(worlds, value, now.s, box, f_draw)
            a = jax.vmap(lambda u: f_tilde.split(u)[0])(box)
            on = jax.vmap(goes_on, in_axes=(None, 0, 0, 0))(ends, now.s, a, s_next)
            old = now.age + 1 >= H
            fresh = old | (on == 0)
            then = Rollouts(jnp.where(fresh[:, None], first, s_next), jnp.where(fresh, 0, now.age + 1))
            return then, (now.s, u, a, bonus, on, s_next, fresh)

        rollouts, (s, u, a, bonus, on, s_next, fresh) = jax.lax.scan(step, rollouts, (act_draws, f_draws, first))
        r = reward.of_steps(s, a) + bonus
        log_prob = jnp.sum(-0.5 * act_draws**2 - policy.log_std[None, None] - LOG_ROOT_2PI, axis=-1)
        v, v_next = jax.vmap(jax.vmap(value))(s), jax.vmap(jax.vmap(value))(s_next)
        delta = r + config.gamma * on * v_next - v
        advantage = advantages(delta, fresh, config.gamma * config.gae_lambda)
        samples = Samples(s, u, log_prob, advantage, advantage + v)
        return rollouts, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)

    def loss(learner: SearchState, batch: Samples, weight: Float[Array, " b"]) -> Scalar:
        policy, value = learner.policy, learner.value
        count = jnp.sum(weight)
        mean_of = lambda x: jnp.sum(jnp.where(weight > 0, x, 0.0)) / count
        centred = batch.advantage - mean_of(batch.advantage)
        advantage = centred / (jnp.sqrt(jnp.sum(weight * centred**2) / (count - 1)) + 1e-8)
        mean, log_std = jax.vmap(policy.gaussian, out_axes=(0, None))(batch.s)
        ratio = jnp.exp(jax.vmap(log_normal, in_axes=(0, 0, None))(batch.u, mean, log_std) - batch.log_prob)
        clipped = jnp.clip(ratio, 1 - config.clip_range, 1 + config.clip_range)
        gain = mean_of(jnp.minimum(advantage * ratio, advantage * clipped))
        error = mean_of((jax.vmap(value)(batch.s) - batch.ret) ** 2)
        entropy = jnp.sum(log_std + 0.5 + LOG_ROOT_2PI)
        return -gain + config.vf_coef * error - config.ent_coef * entropy

    minibatches = -(-config.n_steps // config.batch_size)
    padded = minibatches * config.batch_size
    weight = (jnp.arange(padded) < config.n_steps).astype(jnp.float32).reshape(minibatches, -1)

    def iteration(carry, iteration_key: Key):
        learner, opt_state, rollouts = carry
        imagine_key, shuffle_key = jr.split(iteration_key)
        rollouts, samples = imagine(learner.policy, learner.value, rollouts, imagine_key)

        def epoch(carry, epoch_key: Key):
            order = jnp.pad(jr.permutation(epoch_key, config.n_steps), (0, padded - config.n_steps))
            batches = jax.tree.map(lambda x: x[order].reshape(minibatches, -1, *x.shape[1:]), samples)

            def step(carry, now):
                learner, opt_state = carry
                gradient = jax.grad(loss)(learner, *now)
                gradient = SearchState(unscaled(gradient.policy), unscaled(gradient.value))
                return descend(optimiser, learner, gradient, opt_state), None

            return jax.lax.scan(step, carry, (batches, weight))[0], None

        keys = jr.split(shuffle_key, config.n_epochs)
        (learner, opt_state), _ = jax.lax.scan(epoch, (learner, opt_state), keys)
        return (learner, opt_state, rollouts), None

    begin_key, iterate_key, trial_key = jr.split(key, 3)
    learner = SearchState(policy, value)
    carry = (
        learner,
        descent(optimiser, learner),
        Rollouts(begin(begin_key, (config.rollouts,)), jnp.zeros(config.rollouts)),
    )
    n = -(-config.total_timesteps // config.n_steps)
    (learner, _, _), _ = jax.lax.scan(iteration, carry, jr.split(iterate_key, n))
    everywhere = f_tilde.in_each_member()
    size = {"M": stacked_size(everywhere), "n": config.trial_starts, "steps": min(config.trial_steps, H)}
    chance = Chance.draw(starts.first, **size, key=trial_key)
    return learner, report_of(trials(everywhere, learner.policy, reward, ends, chance))


def advantages(delta: Float[Array, "h n"], fresh: Bool[Array, "h n"], rate: float) -> Float[Array, "h n"]:
    """Σ rate^i δ_{t+i} along each rollout, up to where it ends or begins anew.

    Args:
        delta: TD errors r + γV(s′) - V(s); without γV(s′) where the episode terminated.
        fresh: whether the rollout begins anew after the step.
        rate: γλ.

    Source: generalised advantage estimation, Schulman et al. (2016).
    """

    def backward(after: Float[Array, " n"], now: tuple[Float[Array, " n"], Bool[Array, " n"]]):
        delta, fresh = now
        advantage = delta + rate * jnp.where(fresh, 0.0, after)
        return advantage, advantage

    _, found = jax.lax.scan(backward, jnp.zeros(delta.shape[1]), (delta, fresh), reverse=True)
    return found
