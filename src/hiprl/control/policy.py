"""Policies: a Gaussian squashed into the box, one that is clipped to it, and a random agent."""

from __future__ import annotations

import math
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from hiprl.models.network import MLP, Activation, Scaler
from hiprl.types import Action, Actor, Key, Policy, Scalar, State

MIN_LOG_STD, MAX_LOG_STD = -5.0, 1.0
LOG_ROOT_2PI = 0.5 * math.log(2 * math.pi)


def log_normal(u: Float[Array, " n"], mean: Float[Array, " n"], log_std: Float[Array, " n"]) -> Scalar:
    """Log density of independent Gaussians."""
    return jnp.sum(-0.5 * ((u - mean) / jnp.exp(log_std)) ** 2 - log_std - LOG_ROOT_2PI)


class SquashedPolicy(Policy):
    """tanh of a Gaussian whose mean and spread depend on the state."""

    net: MLP
    inputs: Scaler

    @classmethod
    def draw(
        cls, inputs: Scaler, size: int, *, hidden: tuple[int, ...], activation: Activation, key: Key
    ) -> SquashedPolicy:
        """A policy of `size` outputs whose mean is near zero everywhere, for states in these units."""
        net = MLP.draw(inputs.size, hidden, 2 * size, activation=activation, last_scale=0.01, key=key)
        return cls(net, inputs)

    def gaussian(self, s: State) -> tuple[Float[Array, " size"], Float[Array, " size"]]:
        """Mean and log standard deviation before the squashing."""
        mean, raw = jnp.split(self.net(self.inputs.down(s)), 2)
        span = 0.5 * (MAX_LOG_STD - MIN_LOG_STD)
        return mean, MIN_LOG_STD + span * (1 + jnp.tanh(raw + 0.5))

    def mode(self, s: State) -> Float[Array, " size"]:
        return jnp.tanh(self.gaussian(s)[0])

    def sample(self, s: State, *, key: Key) -> Float[Array, " size"]:
        return self.with_log_prob(s, jr.normal(key, (self.size,)))[0]

    @property
    def size(self) -> int:
        """Entries of the output."""
        return self.net.biases[-1].shape[0] // 2

    def with_log_prob(self, s: State, draw: Float[Array, " size"]) -> tuple[Float[Array, " size"], Scalar]:
        """The sample that a standard normal draw stands for, differentiable in the parameters, and its log density."""
        mean, log_std = self.gaussian(s)
        u = mean + jnp.exp(log_std) * draw
        # log(1 - tanh²u) without loss of digits; log1p would be exact to the last one, at ten times the cost
        squash = 2 * (math.log(2) - jnp.abs(u) - jnp.log(1 + jnp.exp(-2 * jnp.abs(u))))
        log_prob = jnp.sum(-0.5 * draw**2 - log_std - LOG_ROOT_2PI)
        return jnp.tanh(u), log_prob - jnp.sum(squash)

    def rescaled(self, inputs: Scaler) -> SquashedPolicy:
        """The same policy, standardising its input by another scaler."""
        return SquashedPolicy(self.net.with_input_scaler(self.inputs, inputs), inputs)


class ClippedPolicy(Policy):
    """A Gaussian with one spread for all states, clipped to the box: what Stable-Baselines3's PPO learns."""

    net: MLP
    log_std: Float[Array, " size"]
    inputs: Scaler

    @classmethod
    def draw(
        cls, inputs: Scaler, size: int, *, hidden: tuple[int, ...], activation: Activation, key: Key
    ) -> ClippedPolicy:
        net = MLP.draw(inputs.size, hidden, size, activation=activation, last_scale=0.01, key=key)
        return cls(net, jnp.zeros(size), inputs)

    def gaussian(self, s: State) -> tuple[Float[Array, " size"], Float[Array, " size"]]:
        """Mean and log standard deviation before the clipping."""
        return self.net(self.inputs.down(s)), self.log_std

    def mode(self, s: State) -> Float[Array, " size"]:
        return jnp.clip(self.gaussian(s)[0], -1.0, 1.0)

    def sample(self, s: State, *, key: Key) -> Float[Array, " size"]:
        mean, log_std = self.gaussian(s)
        return jnp.clip(mean + jnp.exp(log_std) * jr.normal(key, mean.shape), -1.0, 1.0)

    def rescaled(self, inputs: Scaler) -> ClippedPolicy:
        """The same policy, standardising its input by another scaler."""
        return eqx.tree_at(
            lambda policy: (policy.net, policy.inputs),
            self,
            (self.net.with_input_scaler(self.inputs, inputs), inputs),
        )


class Value(eqx.Module):
    """V(s), the return to be expected from s, as a network's output times a scale."""

    net: MLP
    inputs: Scaler
    scale: Scalar
    """A typical return, in the judge's unit; the network's output is near 1."""

    @classmethod
    def draw(cls, inputs: Scaler, *, hidden: tuple[int, ...], activation: Activation, key: Key) -> Value:
        net = MLP.draw(inputs.size, hidden, 1, activation=activation, last_scale=0.01, key=key)
        return cls(net, inputs, jnp.ones(()))

    def __call__(self, s: State) -> Scalar:
        return self.scale * self.net(self.inputs.down(s))[0]

    def raised(self, by: Scalar) -> Value:
        """V plus so many scales, everywhere."""
        return eqx.tree_at(lambda value: value.net.biases[-1], self, self.net.biases[-1] + by)

    def rescaled(self, inputs: Scaler, scale: Scalar) -> Value:
        """The same V, with other units inside."""
        one = lambda std: Scaler(jnp.zeros(1), std[None])
        net = self.net.with_input_scaler(self.inputs, inputs)
        return Value(net.with_output_scaler(one(self.scale), one(scale)), inputs, scale)


class Uniform(Actor):
    """The random agent of the warm-up: each action uniform in a box of its own size, whatever the state.

    With one size for all, random episodes are alike and comparing them says next to nothing; episodes of different
    effort at once tell what effort is worth to the judge.
    """

    size: Scalar
    """Of the box: actions lie in [-size, size]; at most 1."""
    q: int = eqx.field(static=True)

    @classmethod
    def draw(cls, q: int, *, key: Key) -> Uniform:
        """One whose box has any size up to the whole."""
        return cls(jr.uniform(key), q)

    def act(self, s: State, *, key: Key) -> Action:
        return self.size * jr.uniform(key, (self.q,), minval=-1.0, maxval=1.0)


Net = TypeVar("Net", SquashedPolicy, ClippedPolicy, Value)


def unscaled(gradient: Net) -> Net:
    """The gradient with that of scalers and scales set to zero: they are measured, not trained."""
    units = lambda g: (g.inputs, g.scale) if isinstance(g, Value) else g.inputs
    return eqx.tree_at(units, gradient, jax.tree.map(jnp.zeros_like, units(gradient)))
