"""Features of a state and an action in which the latent reward is linear: a bias, and a function of each coordinate.

Each coordinate counts in proportion, by its square, and on top by a smooth function: a Gaussian process with squared
exponential kernel, written in sine waves. The waves are the same for every lengthscale, which only says how their prior
variances fall: so that one pass over the data serves all lengthscales that are weighed up, "fast is good" (a straight
line) to "stay within a step of this". The kernel is in a coordinate that is as fine where most values lie as it is
coarse far away: a few episodes that went far would else leave nothing fine enough where what is wanted is decided. What
is bowed from end to end, as a price of effort is, would not be smooth there: hence the square.
Source: Solin and Särkkä (2020), Hilbert space methods for reduced-rank Gaussian process regression.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hiprl.models.network import Scaler, sloped
from hiprl.types import Action, Scalar, State

WAVES = 16  # of each coordinate: enough for a lengthscale of 0.5
REACH = 6.0  # where the waves vanish, in the coordinate of the smooth part
SPAN = 4.0  # how far from the middle what was seen may lie in that coordinate
INSIDE = 0.95 * REACH  # what lies past this counts as this
LEAST = 1e-9  # prior variance of a wave: as good as none, and a number that float32 can invert
OWN = 2  # features of a coordinate besides its waves: itself and its square
BOWED = 1 / (2 * 4.0**4)  # prior variance of the square's weight over that of the smooth part: as at a lengthscale of 4
SERIES = 6  # terms of a sine's series past the first
RATE = math.pi / (2 * REACH)  # of the first wave, in radians
FREQUENCIES = RATE * np.arange(1, WAVES + 1)
"""Of the waves, in radians."""


class Kernel(NamedTuple):
    """Of the smooth part of a function of one coordinate, whose straight part has a slope of variance 1."""

    variance: float
    length: float
    """Lengthscale, in usual standard deviations where most values lie."""


class Fine(eqx.Module):
    """The coordinate z in which functions are smooth: u / (1 + a |u|), u in spreads from the middle of most values.

    No coarser far away than it has to be for all that was seen to lie within `SPAN`: a = 0 where it does anyway.
    """

    usual: Scaler
    """Middle and spread of most values."""
    squeeze: Float[Array, " *n"]
    """That a, of each coordinate."""

    @classmethod
    def of(cls, usual: Scaler, low: Float[Array, " n"], high: Float[Array, " n"]) -> Fine:
        """With values between these seen."""
        far = jnp.maximum(-usual.down(low), usual.down(high))
        return cls(usual, jnp.maximum(1 / SPAN - 1 / jnp.maximum(far, SPAN), 0.0))

    def __call__(self, x: Float[Array, " *n"]) -> Float[Array, " *n"]:
        u = self.usual.down(x)
        return u / (1 + self.squeeze * jnp.abs(u))

    def slope(self, x: Float[Array, " *n"]) -> Float[Array, " *n"]:
        """dz/dx."""
        return 1 / (self.usual.std * (1 + self.squeeze * jnp.abs(self.usual.down(x))) ** 2)


class AdditiveFeatures(eqx.Module):
    """φ(s, a) = (1, x, x², sine waves of each z_j) with x = (s, a) standardised and kept in the seen box.

    All but the bias have mean 0 over what was seen. So r̂ has no level of its own that could jump from one refit to
    the next: only where lengths differ do answers say something about a level, and then the bias carries it.
    """

    scaler: Scaler
    low: Float[Array, " n"]
    """Least standardised value that counts; smaller ones count as this."""
    high: Float[Array, " n"]
    fine: Fine
    """From x to z."""
    centre: Float[Array, " D"]
    """Mean of the raw features over what was seen; 0 for the bias."""

    @property
    def size(self) -> int:
        """D, the number of features."""
        return size_of(self.low.shape[0])

    def coordinates(self, s: State, a: Action) -> Float[Array, " n"]:
        """(s, a) in standard units, inside the box."""
        return jnp.clip(self.scaler.down(jnp.concatenate([s, a])), self.low, self.high)

    def __call__(self, s: State, a: Action) -> Float[Array, " D"]:
        x = self.coordinates(s, a)
        return raw_features(x, self.fine(x)) - self.centre

    def dot(self, s: State, a: Action, weights: Float[Array, " D"]) -> Scalar:
        """φ(s, a)ᵀ weights without writing φ out."""
        x = self.coordinates(s, a)
        return weights[0] + jnp.sum(functions(x, self.fine, by_entry(weights).T)) - self.centre @ weights

    def prior(self, kernel: Kernel) -> Float[Array, " D"]:
        """Prior variance of each weight."""
        n = self.low.shape[0]
        # The bias decides where lengths differ and is nowhere else seen: its prior is as wide as all the rest.
        bias = jnp.full(1, n * (1 + kernel.variance))
        tail = jnp.broadcast_to(kernel.variance * spectrum(kernel.length), (n, WAVES)).reshape(-1)
        return jnp.concatenate([bias, jnp.ones(n), jnp.full(n, kernel.variance * BOWED), tail])


@partial(jax.jit, static_argnames=("kernels",))
def priors_of(features: AdditiveFeatures, kernels: tuple[Kernel, ...]) -> Float[Array, "kernels D"]:
    """Prior variance of each weight for each kernel."""
    return jnp.stack([features.prior(kernel) for kernel in kernels])


@partial(jax.jit, static_argnames=("kernels",))
def parts_of(
    features: AdditiveFeatures, kernels: tuple[Kernel, ...]
) -> tuple[Float[Array, "parts D"], Float[Array, "kernels parts"]]:
    """Prior variances whose sums are those for each kernel, and how often each counts.

    One is of the straight part, and one of square and smooth part, of variance 1, for each lengthscale.
    """
    lengths = tuple(dict.fromkeys(kernel.length for kernel in kernels))
    straight, *whole = priors_of(
        features, tuple(Kernel(float(i > 0), length) for i, length in enumerate((1.0, *lengths)))
    )
    shares = [[1.0, *(kernel.variance * (kernel.length == length) for length in lengths)] for kernel in kernels]
    return jnp.stack([straight, *(each - straight for each in whole)]), jnp.array(shares)


def size_of(n: int) -> int:
    """D for n coordinates."""
    return 1 + n * (OWN + WAVES)


def by_entry(x: Float[Array, "*n D"]) -> Float[Array, "*n n m"]:
    """What of θ or φ belongs to each coordinate: its slope, its square and its waves. The bias is left out."""
    n = (x.shape[-1] - 1) // (OWN + WAVES)
    own, waves = x[..., 1 : 1 + OWN * n], x[..., 1 + OWN * n :]
    own = own.reshape(*x.shape[:-1], OWN, n).swapaxes(-1, -2)
    return jnp.concatenate([own, waves.reshape(*x.shape[:-1], n, WAVES)], axis=-1)


def spectrum(length: float) -> Float[np.ndarray, " j"]:
    """Prior variance of each wave's weight, for a kernel of height 1: its spectral density at the wave's frequency."""
    density = math.sqrt(2 * math.pi) * length * np.exp(-0.5 * (length * FREQUENCIES) ** 2)
    return np.maximum(density, LEAST)


def raw_features(x: Float[Array, " n"], z: Float[Array, " n"]) -> Float[Array, " D"]:
    """(1, x, x², sine waves of each z_j)."""
    return jnp.concatenate([jnp.ones(1), x, x**2, jnp.stack(waves(z), axis=1).reshape(-1)])


def waves(z: Float[Array, " n"]) -> list[Float[Array, " n"]]:
    """sin(j π (z + L) / 2L) / √L for j = 1, 2, … with L = `REACH`, each from the two before."""
    sine = turn_of(z)
    wave, twice = jnp.sqrt(1 - sine**2) / math.sqrt(REACH), -2 * sine
    found = [wave, twice * wave]
    for _ in range(WAVES - 2):
        found.append(twice * found[-1] - found[-2])
    return found


def functions(x: Float[Array, "..."], fine: Fine, weights: Float[Array, "..."]) -> Float[Array, "..."]:
    """What each x counts for: weights[0] times itself, weights[1] times x², and the further ones times the waves of z.

    By Clenshaw's recurrence, which needs no wave of its own, and with the slope found on the way: a backward pass
    through the waves would take several times as long. All but x is constant to it.
    """
    return sloped(partial(_value_and_slope, fine, weights))(x)


def _value_and_slope(
    fine: Fine, weights: Float[Array, "..."], x: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    z = fine(x)
    sine = turn_of(z)
    slope, before = _clenshaw(sine, [j * weights[OWN - 1 + j] for j in range(1, WAVES + 1)])
    turn = jnp.where(jnp.abs(z) < INSIDE, slope * sine + before, 0.0) * fine.slope(x)
    return by_turn(x, sine, weights), weights[0] + 2 * weights[1] * x - RATE / math.sqrt(REACH) * turn


def by_turn(x: Float[Array, "..."], sine: Float[Array, "..."], weights: Float[Array, "..."]) -> Float[Array, "..."]:
    """What each x counts for, as `functions` has it, where what `turn_of` gives is known already."""
    value, _ = _clenshaw(sine, [weights[OWN - 1 + j] for j in range(1, WAVES + 1)])
    return (weights[0] + weights[1] * x) * x + 1 / math.sqrt(REACH) * jnp.sqrt(1 - sine**2) * value


def _clenshaw(
    sine: Float[Array, "..."], weights: list[Float[Array, "..."]]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Of the waves with these weights, over their first one, and the same from the second on."""
    value, before, twice = jnp.zeros_like(sine), jnp.zeros_like(sine), -2 * sine
    for weight in reversed(weights):
        value, before = weight + twice * value - before, value
    return value, before


def turn_of(z: Float[Array, "..."]) -> Float[Array, "..."]:
    """Sine of the angle of the waves at z less a right one: all that they depend on."""
    return sine_of(RATE * jnp.clip(z, -INSIDE, INSIDE))


def sine_of(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Sin x between two right angles, to 1e-7: by its series, since XLA's own takes most of the time of all waves."""
    square, total = x**2, jnp.zeros_like(x)
    for k in range(SERIES, 0, -1):
        total = square * ((-1) ** k / math.factorial(2 * k + 1) + total)
    return x * (1 + total)
