"""M Gaussian networks give μ, σ (epistemic) and the noise."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from hiprl.models.network import MLP, Activation, Scaler
from hiprl.types import Action, Dynamics, Key, Prediction, State

MIN_LOG_VAR, MAX_LOG_VAR = -10.0, 1.0  # of the standardised step s' - s


def bounded_var(raw: Float[Array, " p"]) -> Float[Array, " p"]:
    """A variance whose log is kept softly between its bounds, so that neither a flat nor a sharp one runs away.

    Two softplus, one from each bound, written out: with e = exp(raw) their variance is a ratio in e, so that one
    exponential does, forward and backward.
    """
    e = jnp.exp(jnp.minimum(raw, 40.0))  # more overflows, and the bound was reached long before
    low = math.exp(MIN_LOG_VAR)
    return low + e / (1 + e * math.exp(-MAX_LOG_VAR))


class Member(Dynamics):
    """One Gaussian network: s, a to the mean and the noise of s′ - s. It is sure of itself: σ = 0."""

    net: MLP
    inputs: Scaler
    """Of (s, a) together."""
    steps: Scaler
    """Of s′ - s."""

    def standardised(self, s: State, a: Action) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Mean and variance of s′ - s, in standard units."""
        out = self.net(self.inputs.down(jnp.concatenate([s, a])))
        mean, raw = jnp.split(out, 2)
        return mean, bounded_var(raw)

    def predict(self, s: State, a: Action) -> Prediction:
        mean, var = self.standardised(s, a)
        return Prediction(
            mu=s + self.steps.up(mean),
            sigma=jnp.zeros_like(s),
            noise=self.steps.std * jnp.sqrt(var),
        )

    def members(self) -> Dynamics:
        return jax.tree.map(lambda x: x[None], self)

    def rescaled(self, inputs: Scaler, steps: Scaler) -> Member:
        """The same mean as a function of raw input and output, with other scalers."""
        net = self.net.with_input_scaler(self.inputs, inputs).with_output_scaler(self.steps, steps)
        return Member(net, inputs, steps)

    def quieter(self, share: Float[Array, " p"]) -> Member:
        """The same with so much of the variance of its noise, but for the bounds of that."""
        bias = self.net.biases[-1]
        lowered = bias.at[bias.shape[0] // 2 :].add(jnp.log(share))
        return eqx.tree_at(lambda member: member.net.biases[-1], self, lowered)


class Ensemble(Dynamics):
    """M members, each with its own weights and its own bootstrap of the data.

    σ is the spread of the members' means; their noise heads are the world's noise and no part of it.
    Source: after Chua et al. (2018); HIP-RL Appendix B.
    """

    stack: Member
    """Every leaf has a leading axis M."""

    @classmethod
    def draw(
        cls, inputs: Scaler, steps: Scaler, *, M: int, hidden: tuple[int, ...], activation: Activation, key: Key
    ) -> Ensemble:
        """M members with weights of their own, for (s, a) and s′ - s in these units."""

        def one(member_key: Key) -> Member:
            net = MLP.draw(inputs.size, hidden, 2 * steps.size, activation=activation, key=member_key)
            return Member(net, inputs, steps)

        return cls(jax.vmap(one)(jr.split(key, M)))

    @property
    def M(self) -> int:
        return self.stack.steps.mean.shape[0]

    @property
    def step_scale(self) -> Float[Array, " p"]:
        """Spread of s′ - s over the data, the unit in which errors are compared across dimensions."""
        return self.stack.steps.std[0]

    def predict(self, s: State, a: Action) -> Prediction:
        each = jax.vmap(Member.predict, in_axes=(0, None, None))(self.stack, s, a)
        mu = jnp.mean(each.mu, axis=0)
        var = jnp.sum((each.mu - mu[None]) ** 2, axis=0) / (self.M - 1)
        tiny = 1e-12 * self.step_scale**2  # keeps the gradient of the root finite where members agree
        return Prediction(mu, jnp.sqrt(var + tiny), jnp.sqrt(jnp.mean(each.noise**2, axis=0)))

    def members(self) -> Dynamics:
        return self.stack
