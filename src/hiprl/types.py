"""The shapes and roles that all parts share: State, Action, Eta; what a Dynamics, a Reward, a Policy is."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int
from jaxtyping import Key as KeyOf

State: TypeAlias = Float[Array, " p"]
Action: TypeAlias = Float[Array, " q"]
Eta: TypeAlias = Float[Array, " p"]
Scalar: TypeAlias = Float[Array, ""]
Count: TypeAlias = Int[Array, ""]
Flag: TypeAlias = Bool[Array, ""]
Key: TypeAlias = KeyOf[Array, ""]


class Prediction(NamedTuple):
    """What a dynamics model says of the next state, in the units of the state."""

    mu: State
    """Mean μ of the next state."""
    sigma: State
    """Epistemic standard deviation σ: what more data would remove."""
    noise: State
    """Standard deviation of the world's noise ω: what no data removes."""


class Dynamics(eqx.Module):
    """A belief about f: gives μ, σ and the noise at one state and one action in [-1, 1]^q."""

    @abstractmethod
    def predict(self, s: State, a: Action) -> Prediction:
        """Belief about the state that follows `s` under `a`."""

    @abstractmethod
    def members(self) -> Dynamics:
        """Draws from the belief, stacked along a leading axis; a draw is sure of itself (σ = 0)."""


class Reward(eqx.Module):
    """An estimate r̂ of the latent reward; more is better."""

    @abstractmethod
    def __call__(self, s: State, a: Action) -> Scalar:
        """r̂(s, a), in the judge's unit a step."""

    def of_steps(self, s: Float[Array, "*n p"], a: Float[Array, "*n q"]) -> Float[Array, " *n"]:
        """The same of many steps at once, for which there may be a faster way than one after the other."""
        return jnp.vectorize(self, signature="(p),(q)->()")(s, a)


class Policy(eqx.Module):
    """A stochastic rule for actions. All actions lie in [-1, 1]; the world scales them."""

    @abstractmethod
    def mode(self, s: State) -> Float[Array, " q_plus"]:
        """The action (and, after it, any hallucinated control) without exploration noise."""

    @abstractmethod
    def sample(self, s: State, *, key: Key) -> Float[Array, " q_plus"]:
        """A draw of the same."""


class Actor(eqx.Module):
    """What executes in a world: a policy, a planner, a random agent."""

    @abstractmethod
    def act(self, s: State, *, key: Key) -> Action:
        """The action to execute in `s`; each entry in [-1, 1]."""


def stacked_size(tree: eqx.Module) -> int:
    """Length of the leading axis of a stack of modules."""
    return jax.tree.leaves(eqx.filter(tree, eqx.is_array))[0].shape[0]
