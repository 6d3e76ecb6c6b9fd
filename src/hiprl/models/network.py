"""One fully connected network, and the standardising of what goes in and comes out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Bool, Float

from hiprl.data.trajectory_set import Trajectories
from hiprl.types import Key

Activation: TypeAlias = Literal["relu", "silu", "elu", "tanh"]


def sloped(both: Callable[[Array], tuple[Array, Array]]) -> Callable[[Array], Array]:
    """A function of each entry from one that gives its value and its slope: all that a backward pass has to keep."""
    act = jax.custom_jvp(lambda x: both(x)[0])

    @act.defjvp
    def tangent(at: tuple[Array], along: tuple[Array]) -> tuple[Array, Array]:
        value, slope = both(*at)
        return value, slope * along[0]

    return act


@sloped
def elu(x: Array) -> tuple[Array, Array]:
    """Itself above zero, exp x - 1 below; expm1 would take twice as long, for digits that nobody needs."""
    below = jnp.exp(jnp.minimum(x, 0.0))
    return jnp.maximum(x, 0.0) + (below - 1), below


@sloped
def silu(x: Array) -> tuple[Array, Array]:
    """Times its sigmoid."""
    gate = jax.nn.sigmoid(x)
    return x * gate, gate * (1 + x * (1 - gate))


ACTIVATIONS: dict[Activation, Callable[[Array], Array]] = {
    "relu": jax.nn.relu,
    "silu": silu,
    "elu": elu,
    "tanh": jnp.tanh,
}

FEW = 8  # entries of what a network is asked about, up to which 64 units a layer say all there is to say
CONSTANT = 1e-5  # a spread below this share of the values is what rounding leaves of a constant
STILL = 1e-2  # of the spread of states: the unit of a step that is always 0


class Scaler(eqx.Module):
    """Maps a vector to zero mean and unit spread, and back; or many, whatever fits to mean and spread."""

    mean: Float[Array, " *n"]
    std: Float[Array, " *n"]

    @property
    def size(self) -> int:
        return self.mean.shape[0]

    @classmethod
    def of(cls, x: Float[Array, "rows n"], mask: Bool[Array, " rows"]) -> Scaler:
        """Mean and spread of the masked rows; an entry that never varies keeps its unit."""
        count = jnp.maximum(jnp.sum(mask), 1)
        mean = jnp.sum(jnp.where(mask[:, None], x, 0.0), axis=0) / count
        var = jnp.sum(jnp.where(mask[:, None], (x - mean[None]) ** 2, 0.0), axis=0) / count
        std = jnp.sqrt(var)
        return cls(mean, jnp.where(std > CONSTANT * jnp.abs(mean), std, 1.0))

    def down(self, x: Float[Array, " *n"]) -> Float[Array, " *n"]:
        """To standard units."""
        return (x - self.mean) / self.std

    def up(self, z: Float[Array, " *n"]) -> Float[Array, " *n"]:
        """To the units of the data."""
        return z * self.std + self.mean


def step_scaler(T: Trajectories) -> Scaler:
    """Mean and spread of s′ - s over T.

    An entry that stands still in every episode, as a goal does that is drawn anew for each, has a unit far below what
    it differs by: in its own, which would be 1, the noise of a network would carry it away.
    """
    rows = T.transitions()
    found = Scaler.of(rows.s_next - rows.s, rows.mask)
    still = ~jnp.any((rows.s_next != rows.s) & rows.mask[:, None], axis=0)
    return Scaler(found.mean, jnp.where(still, STILL * state_scaler(T).std, found.std))


def state_action_scaler(T: Trajectories) -> Scaler:
    """Mean and spread of (s, a) over T."""
    rows = T.transitions()
    return Scaler.of(jnp.concatenate([rows.s, rows.a], axis=1), rows.mask)


def state_scaler(T: Trajectories) -> Scaler:
    """Mean and spread of the states in which actions were taken."""
    rows = T.transitions()
    return Scaler.of(rows.s, rows.mask)


class MLP(eqx.Module):
    """Layers of weights and biases with one activation between them."""

    weights: tuple[Float[Array, "_i _o"], ...]
    biases: tuple[Float[Array, " _o"], ...]
    activation: Activation = eqx.field(static=True)

    @classmethod
    def draw(
        cls,
        in_size: int,
        hidden: tuple[int, ...],
        out_size: int,
        *,
        activation: Activation,
        last_scale: float = 1.0,
        key: Key,
    ) -> MLP:
        """Weights N(0, 1 / fan-in), those of the last layer times `last_scale`; biases 0."""
        sizes = (in_size, *hidden, out_size)
        scales = [1.0] * len(hidden) + [last_scale]
        keys = jr.split(key, len(scales))
        weights = tuple(
            scale * jr.normal(k, (i, o)) / jnp.sqrt(i)
            for k, i, o, scale in zip(keys, sizes[:-1], sizes[1:], scales, strict=True)
        )
        return cls(weights, tuple(jnp.zeros(o) for o in sizes[1:]), activation)

    def __call__(self, x: Float[Array, " i"]) -> Float[Array, " o"]:
        act = ACTIVATIONS[self.activation]
        for w, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = act(x @ w + b)
        return x @ self.weights[-1] + self.biases[-1]

    def with_input_scaler(self, old: Scaler, new: Scaler) -> MLP:
        """The same function of raw input, when its input will be standardised by `new` in place of `old`."""
        w, b = self.weights[0], self.biases[0]
        return eqx.tree_at(
            lambda net: (net.weights[0], net.biases[0]),
            self,
            (w * (new.std / old.std)[:, None], b + ((new.mean - old.mean) / old.std) @ w),
        )

    def with_output_scaler(self, old: Scaler, new: Scaler) -> MLP:
        """The same function to raw output, for the first entries of the output that `old` and `new` scale."""
        n = old.mean.shape[0]
        w, b = self.weights[-1], self.biases[-1]
        ratio = old.std / new.std
        return eqx.tree_at(
            lambda net: (net.weights[-1], net.biases[-1]),
            self,
            (
                w.at[:, :n].multiply(ratio),
                b.at[:n].set(b[:n] * ratio + (old.mean - new.mean) / new.std),
            ),
        )
