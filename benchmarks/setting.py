"""A learned world to search in: random episodes of a task, an ensemble and a reward fitted to them."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
from jax.tree_util import Partial

from benchmarks.common import progress
from hiprl.config import Config
from hiprl.control.imagined import Ends, SearchState
from hiprl.control.policy import Uniform
from hiprl.control.search import new_search
from hiprl.data.preference import Preferences, gap
from hiprl.data.trajectory_set import Trajectories
from hiprl.hallucinated import Hallucinated
from hiprl.models.dynamics import DynamicsState, estimate_dynamics, new_dynamics
from hiprl.models.estimate import estimate_reward, new_reward
from hiprl.models.reward import BOX_MARGIN, EstimatedReward
from hiprl.types import Key
from hiprl.world.build import world_from
from hiprl.world.task import World

EPISODES = 6


class Setting(NamedTuple):
    """What a search gets."""

    world: World
    T: Trajectories
    dynamics: DynamicsState
    f_tilde: Hallucinated
    reward: EstimatedReward
    ends: Ends | None
    state: SearchState
    """Where the search begins."""


def setting(env: str, config: Config, *, key: Key) -> Setting:
    """Six random episodes in `env`, five answers about them, both models fitted as a first fit would be."""
    progress(f"{env}: six random episodes, and models fitted to them")
    world_key, dynamics_key, fit_key, reward_key, search_key = jr.split(key, 5)
    world = world_from(env)
    T = Trajectories.empty(config.comparisons + 1, H=world.H, p=world.p, q=world.q)
    P = Preferences.empty(config.comparisons)
    for k, episode_key in enumerate(jr.split(world_key, EPISODES)):
        size_key, roll_key = jr.split(episode_key)
        T = T.add(world.roll_out(Uniform.draw(world.q, key=size_key), key=roll_key))
        if k:
            P = P.add(gap(T.get(k), T.get(k - 1)), T.last, T.last - 1)
    dynamics, _ = estimate_dynamics(
        T,
        new_dynamics(T, config.dynamics, key=dynamics_key),
        config.dynamics,
        steps=config.dynamics.cold_steps,
        key=fit_key,
    )
    reward = estimate_reward(P, T, new_reward(P, T, config.reward, key=reward_key), config.reward)
    low, high = T.box(margin=BOX_MARGIN)
    f_tilde = Hallucinated(
        dynamics=dynamics.ensemble,
        beta=jnp.ones(world.p),
        bonus=config.bonus * reward.unit,
        step_scale=dynamics.ensemble.step_scale,
        low=low,
        high=high,
        mode=config.optimism,
    )
    ends = Partial(world.terminates) if world.ends and world.terminates is not None else None
    state = new_search(T, world.q + config.eta_size(world.p), config.search, key=search_key)
    return jax.block_until_ready(Setting(world, T, dynamics, f_tilde, reward, ends, state))
