"""The paper's reward model: a small network, trained on eq. (59)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Float

from hiprl.data.preference import Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.models.fit import descend, descent
from hiprl.models.network import MLP, Activation, Scaler, state_action_scaler
from hiprl.models.reward import EstimatedReward, Gap
from hiprl.models.usual import typical_size
from hiprl.types import Action, Key, Scalar, State


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """How the reward network is built and trained (Appendix B)."""

    members: int = 5
    """Networks; r̂ is their mean. The paper has one; the others only give σ_g its spread."""
    hidden: tuple[int, ...] = (32, 32)
    """Units of the hidden layers (paper: two layers of 32)."""
    activation: Activation = "relu"
    """Between layers."""
    learning_rate: float = 1e-2
    """Of Adam (paper)."""
    steps: int = 200
    """Gradient steps after each answer, each on all answers. The paper does not say how many."""

    def __post_init__(self) -> None:
        if self.members < 2:
            raise InputError(
                f"got {self.members} reward networks; at least 2 are needed, as σ_g is the spread of what they "
                "predict. Take 5."
            )


class NetworkReward(EstimatedReward):
    """r̂ is the mean of small networks, σ_g the spread of what they predict of a preference."""

    nets: MLP
    """Stacked along a leading axis."""
    inputs: Scaler
    """Of (s, a) together."""

    def each(self, s: State, a: Action) -> Float[Array, " M"]:
        """The reward by each network."""
        x = self.inputs.down(jnp.concatenate([s, a]))
        return jax.vmap(MLP.__call__, in_axes=(0, None))(self.nets, x)[:, 0]

    def __call__(self, s: State, a: Action) -> Scalar:
        return jnp.mean(self.each(s, a))

    def sums(self, tau: Trajectory) -> Float[Array, " M"]:
        """The return of τ by each network."""
        rows = tau.transitions()
        r = jax.vmap(self.each)(rows.s, rows.a)
        return jnp.sum(jnp.where(rows.mask[:, None], r, 0.0), axis=0)

    def gap(self, tau: Trajectory, other: Trajectory) -> Gap:
        by_net = self.sums(tau) - self.sums(other)
        return Gap(jnp.mean(by_net), jnp.std(by_net, ddof=1))

    def returns(self, T: Trajectories) -> Float[Array, " N"]:
        return returns_of(self, T)


@jax.jit
def returns_of(reward: NetworkReward, T: Trajectories) -> Float[Array, " N"]:
    """Mean over the networks of the return of each trajectory of T; minus infinity past the count."""
    return jnp.where(T.filled, jnp.mean(jax.vmap(reward.sums)(T.rows), axis=1), -jnp.inf)


@partial(jax.jit, static_argnames=("config",))
def new_network_reward(T: Trajectories, config: NetworkConfig, *, key: Key) -> NetworkReward:
    """Networks that have seen no answer."""
    n = T.rows.states.shape[2] + T.rows.actions.shape[2]
    draw = lambda key: MLP.draw(n, config.hidden, 1, activation=config.activation, key=key)
    nets = jax.vmap(draw)(jr.split(key, config.members))
    return NetworkReward(jnp.ones(()), nets, state_action_scaler(T))


@partial(jax.jit, static_argnames=("config",))
def estimate_network_reward(
    P: Preferences, T: Trajectories, reward: NetworkReward, config: NetworkConfig
) -> NetworkReward:
    """Trains the networks on all answers, from the weights they have.

    Only trajectories in T are looked at, each once a step: the loss is that of eq. (59), mean squared error of g.
    """
    inputs = state_action_scaler(T)
    nets = jax.vmap(MLP.with_input_scaler, in_axes=(0, None, None))(reward.nets, reward.inputs, inputs)
    n = jnp.maximum(jnp.sum(P.filled), 1)
    optimiser = optax.adam(config.learning_rate)

    def loss(nets: MLP) -> Scalar:
        sums = jax.vmap(NetworkReward(reward.unit, nets, inputs).sums)(T.rows)
        error = P.g[:, None] - (sums[P.first] - sums[P.second])
        return jnp.sum(jnp.where(P.filled[:, None], error**2, 0.0)) / n

    def step(carry, _):
        nets, opt_state = carry
        return descend(optimiser, nets, jax.grad(loss)(nets), opt_state), None

    (nets, _), _ = jax.lax.scan(step, (nets, descent(optimiser, nets)), length=config.steps)
    trained = NetworkReward(jnp.ones(()), nets, inputs)
    rows = T.transitions()
    return eqx.tree_at(lambda r: r.unit, trained, typical_size(jax.vmap(trained)(rows.s, rows.a), T))
