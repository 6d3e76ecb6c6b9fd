"""A pendulum to swing up, paid only near the top and charged for torque: greedy learners stay below."""

from __future__ import annotations

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from hiprl.types import Action, Flag, Key, Scalar, State
from hiprl.world.task import Task


class SwingUp(Task):
    """Swing-up with a narrow reward; the state is (cos θ, sin θ, θ̇), θ = 0 at the top.

    The torque is 1 N m at most, and gravity pulls with up to 1.47 N m: the pendulum must gain height over
    several swings. The reward is 1 within 18° of the top at less than 0.5 rad/s, and vanishes a little
    outside; with a price on torque, an attempt that misses the top is worth less than doing nothing.

    Differs from the source in three ways: the source observes θ itself, hangs exactly still at the start, and lets
    imagination begin at any angle, but at rest only.

    Source: Curi et al. (2020), experiments on the inverted pendulum, and the code released with them: mass,
    length, friction, time step, horizon, reward and torque limit.
    """

    action_cost: Scalar = eqx.field(converter=jnp.float32, default=0.0)
    """What a full torque costs a step; the source compares 0, 0.1 and 0.2."""
    name: ClassVar[str] = "swing-up"
    ends: ClassVar[bool] = False

    @property
    def p(self) -> int:
        return 3

    @property
    def q(self) -> int:
        return 1

    @property
    def H(self) -> int:
        return 400

    def f(self, s: State, a: Action, key: Key) -> State:
        """The state 1/80 s later, by a Runge-Kutta step of I θ̈ = m g l sin θ + a - b θ̇. There is no noise."""
        theta, omega = jnp.arctan2(s[1], s[0]), s[2]
        x = jnp.stack([theta, omega])
        h = _TIME_STEP
        k_1 = _velocity(x, a[0])
        k_2 = _velocity(x + h / 2 * k_1, a[0])
        k_3 = _velocity(x + h / 2 * k_2, a[0])
        k_4 = _velocity(x + h * k_3, a[0])
        theta, omega = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        return jnp.stack([jnp.cos(theta), jnp.sin(theta), omega])

    def r(self, s: State, a: Action) -> Scalar:
        """Near the top and slow, minus the price of torque (the first 0.1 of it is free)."""
        upright = tolerance(s[0], low=0.95, high=1.0, margin=0.1)
        slow = tolerance(s[2], low=-0.5, high=0.5, margin=0.5)
        lazy = tolerance(a[0], low=-0.1, high=0.1, margin=0.1)
        return upright * slow - self.action_cost * (1.0 - lazy)

    def s_0(self, key: Key) -> State:
        """Hanging down, all but still: standard deviations of 0.01 rad and 0.01 rad/s."""
        off, omega = 0.01 * jr.normal(key, (2,))
        return jnp.stack([-jnp.cos(off), -jnp.sin(off), omega])

    def anywhere(self) -> Float[Array, "n p"]:
        """All round, at rest, and as fast either way as a fall from the top makes it."""
        theta = jnp.linspace(0.0, 2 * math.pi, 128, endpoint=False)
        fall = jnp.sqrt(2 * _GRAVITY / _LENGTH * (1 - jnp.cos(theta)))
        around = lambda omega: jnp.stack([jnp.cos(theta), jnp.sin(theta), omega], axis=1)
        still = around(jnp.zeros_like(theta))
        return jnp.concatenate([still, around(fall), still, around(-fall)])

    def terminates(self, s: State, a: Action, s_next: State) -> Flag:
        return jnp.asarray(False)


def tolerance(x: Scalar, *, low: float, high: float, margin: float) -> Scalar:
    """1 for `x` in [low, high]; outside it falls off like a Gaussian, to 0.1 at a distance of `margin`.

    Source: `tolerance` of the DeepMind Control Suite (Tassa et al., 2018).
    """
    outside = jnp.maximum(jnp.abs(x - (low + high) / 2) - (high - low) / 2, 0.0)
    return jnp.exp(math.log(0.1) * (outside / margin) ** 2)


def _velocity(x, torque):
    """Time derivative of (θ, θ̇)."""
    theta, omega = x
    inertia = _MASS * _LENGTH**2
    return jnp.stack([omega, _GRAVITY / _LENGTH * jnp.sin(theta) + (torque - _FRICTION * omega) / inertia])


_GRAVITY = 9.81  # m / s²
_MASS = 0.3  # kg
_LENGTH = 0.5  # m
_FRICTION = 0.005  # N m s
_TIME_STEP = 1 / 80  # s
