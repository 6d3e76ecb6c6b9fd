"""Small worlds and settings for tests of whole runs: everything compiles once and runs in seconds."""

from dataclasses import replace

import gymnasium as gym
import jax.numpy as jnp
import numpy as np

from hiprl.config import Config
from hiprl.control.gradient import GradientConfig
from hiprl.data.answer import number
from hiprl.data.preference import gap
from hiprl.data.trajectory import Trajectory
from hiprl.models.dynamics import DynamicsConfig
from hiprl.world.task import World

DYNAMICS = DynamicsConfig(M=3, hidden=(16,), cold_steps=100, warm_steps=50, chunk=50, batch=32)
SEARCH = GradientConfig(chunks=2, updates=20, rollouts=4, steps=5, trial_steps=10, trial_starts=2, hidden=(16,))
TINY = Config(comparisons=6, warm_up=3, dynamics=DYNAMICS, search=SEARCH)
"""Learns next to nothing, quickly."""
DREAMING = replace(TINY, comparisons=4, question=replace(TINY.question, imagined=True))
"""The same with questions about what was imagined; its trajectories are as many, so that little compiles anew."""


def exactly(question, run, *, key):
    """The exact judge, asked by Algorithm 1 itself."""
    T = question.attempt.added(run.T)
    return number(gap(*(T.clip(clip) for clip in question.shown)))


class Blind(World):
    """Another world, but for what it pays: no trajectory of it knows a reward."""

    def __init__(self, world: World):
        self.world = world
        self.name, self.p, self.q, self.H = world.name, world.p, world.q, world.H
        self.terminates, self.ends = world.terminates, world.ends

    def roll_out(self, actor, *, key):
        tau = self.world.roll_out(actor, key=key)
        return Trajectory(tau.states, tau.actions, jnp.full_like(tau.rewards, jnp.nan), tau.length, tau.terminated)

    def spec(self):
        return None


class Sledge(gym.Env):
    """Three numbers that two pushes move; there is no reward, and nobody says when an episode ends but the clock."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = gym.spaces.Box(-2.0, 4.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.s = self.np_random.normal(0, 0.1, 3)
        return self.s.astype(np.float32), {}

    def step(self, action):
        push = (np.asarray(action, float) - 1) / 3  # the middle of the bounds pushes nothing
        self.s = 0.8 * self.s + 0.3 * np.array([push[0], push[1], push[0] - push[1]])
        return self.s.astype(np.float32), None, False, False, {}
