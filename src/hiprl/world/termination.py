"""When the well-known environments end an episode, as functions of (s, a, s′) in pure JAX.

A model of the world imagines episodes that never end unless it knows when they do; a fall is rare in the data
and dear in the world, so a rule that is known is better than one that is learned. Rules are frozen
dataclasses or plain functions: equal rules hash alike, so nothing compiles twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import jax.numpy as jnp

from hiprl.types import Action, Flag, State
from hiprl.world.task import Terminates


def never(s: State, a: Action, s_next: State) -> Flag:
    """No step ends an episode: HalfCheetah, Swimmer, Reacher, Pusher, Pendulum."""
    return jnp.asarray(False)


@dataclass(frozen=True)
class Leaves:
    """The episode ends where an entry of s′ leaves its interval, or is not finite."""

    intervals: tuple[tuple[int, float, float], ...]
    """(entry of s′, low, high), in the units of the observation."""
    rest: tuple[int, float, float] = (0, -math.inf, math.inf)
    """(n, low, high): the interval of all entries from number n on."""
    closed: bool = False
    """Whether low and high themselves are still inside."""

    def __call__(self, s: State, a: Action, s_next: State) -> Flag:
        start, low, high = self.rest
        inside = jnp.all(jnp.isfinite(s_next)) & jnp.all((low < s_next[start:]) & (s_next[start:] < high))
        for entry, low, high in self.intervals:
            x = s_next[entry]
            inside &= (low <= x) & (x <= high) if self.closed else (low < x) & (x < high)
        return ~inside


@dataclass(frozen=True)
class ReachesGoal:
    """MountainCarContinuous: the car is at the goal or past it, and no slower than the goal asks."""

    position: float
    velocity: float

    def __call__(self, s: State, a: Action, s_next: State) -> Flag:
        return (s_next[0] >= self.position) & (s_next[1] >= self.velocity)


def double_pendulum_falls(s: State, a: Action, s_next: State) -> Flag:
    """InvertedDoublePendulum: the tip of the second pole is no higher than 1.

    Both poles are 0.6 long; the observation has sin θ₁, sin θ₂, cos θ₁, cos θ₂ from its second entry on, θ₂
    relative to θ₁. MuJoCo reads the tip from the last stage of its Runge-Kutta step, not from s′ itself: at
    the very edge the environment may end one step earlier or later than this rule.
    """
    sin_1, sin_2, cos_1, cos_2 = s_next[1], s_next[2], s_next[3], s_next[4]
    return ~(0.6 * cos_1 + 0.6 * (cos_1 * cos_2 - sin_1 * sin_2) > 1.0)


def known_rule(env: gym.Env) -> Terminates | None:
    """The rule by which `env` ends its episodes; None where it is not known.

    It is known for Gymnasium's own MuJoCo (v4, v5) and classic control environments with continuous actions,
    with any of their arguments, as long as no wrapper changes what is observed or when an episode ends.
    """
    inner = env
    while isinstance(inner, gym.Wrapper):
        if type(inner) not in _HARMLESS:
            return None
        inner = inner.env
    kind = f"{type(inner).__module__}.{type(inner).__name__}"
    if not kind.startswith(("gymnasium.envs.mujoco.", "gymnasium.envs.classic_control.")):
        return None
    name = kind.rsplit(".", 1)[1].removesuffix("Env")
    if name in _NEVER:
        return never
    if name in _UNHEALTHY and not inner._terminate_when_unhealthy:  # pyright: ignore[reportAttributeAccessIssue]
        return never
    return _RULES[name](inner) if name in _RULES else None


def _inverted_pendulum(env) -> Terminates:
    return Leaves(intervals=((1, -0.2, 0.2),), closed=True)


def _inverted_double_pendulum(env) -> Terminates | None:
    own = Path(gym.__file__).parent / "envs" / "mujoco" / "assets" / "inverted_double_pendulum.xml"
    return double_pendulum_falls if Path(env.fullpath) == own else None


def _hopper(env) -> Terminates:
    z = 0 if env._exclude_current_positions_from_observation else 1
    # Velocities are observed clipped to ±10, which the default range (-100, 100) never notices.
    return Leaves(
        intervals=((z, *env._healthy_z_range), (z + 1, *env._healthy_angle_range)),
        rest=(z + 1, *env._healthy_state_range),
    )


def _walker2d(env) -> Terminates:
    z = 0 if env._exclude_current_positions_from_observation else 1
    return Leaves(intervals=((z, *env._healthy_z_range), (z + 1, *env._healthy_angle_range)))


def _ant(env) -> Terminates:
    z = 0 if env._exclude_current_positions_from_observation else 2
    return Leaves(intervals=((z, *env._healthy_z_range),), closed=True)


def _humanoid(env) -> Terminates:
    z = 0 if env._exclude_current_positions_from_observation else 2
    return Leaves(intervals=((z, *env._healthy_z_range),))


def _mountain_car(env) -> Terminates:
    return ReachesGoal(position=float(env.goal_position), velocity=float(env.goal_velocity))


_NEVER = frozenset({"HalfCheetah", "Swimmer", "Reacher", "Pusher", "HumanoidStandup", "Pendulum"})
_UNHEALTHY = frozenset({"Hopper", "Walker2d", "Ant", "Humanoid"})
_RULES = {
    "InvertedPendulum": _inverted_pendulum,
    "InvertedDoublePendulum": _inverted_double_pendulum,
    "Hopper": _hopper,
    "Walker2d": _walker2d,
    "Ant": _ant,
    "Humanoid": _humanoid,
    "Continuous_MountainCar": _mountain_car,
}
_HARMLESS = frozenset(
    {
        gym.wrappers.ClipAction,
        gym.wrappers.HumanRendering,
        gym.wrappers.NormalizeReward,
        gym.wrappers.OrderEnforcing,
        gym.wrappers.PassiveEnvChecker,
        gym.wrappers.RecordEpisodeStatistics,
        gym.wrappers.RecordVideo,
        gym.wrappers.RenderCollection,
        gym.wrappers.RescaleAction,
        gym.wrappers.TimeLimit,
        gym.wrappers.TransformAction,
        gym.wrappers.TransformReward,
    }
)
