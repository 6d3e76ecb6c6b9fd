"""EstReward(P, T), by the model that the config names."""

from __future__ import annotations

from typing import TypeAlias

from hiprl.data.preference import Preferences
from hiprl.data.trajectory_set import Trajectories
from hiprl.models.reward import AdditiveConfig, EstimatedReward, estimate_additive_reward
from hiprl.models.reward_network import (
    NetworkConfig,
    NetworkReward,
    estimate_network_reward,
    new_network_reward,
)
from hiprl.types import Key

RewardConfig: TypeAlias = AdditiveConfig | NetworkConfig


def new_reward(P: Preferences, T: Trajectories, config: RewardConfig, *, key: Key) -> EstimatedReward:
    """The reward before any answer."""
    if isinstance(config, NetworkConfig):
        return new_network_reward(T, config, key=key)
    return estimate_additive_reward(P, T, config)


def estimate_reward(P: Preferences, T: Trajectories, before: EstimatedReward, config: RewardConfig) -> EstimatedReward:
    """The reward after the answers in P; networks go on from the weights in `before`. Eq. (7)."""
    if isinstance(config, NetworkConfig):
        assert isinstance(before, NetworkReward)
        return estimate_network_reward(P, T, before, config)
    return estimate_additive_reward(P, T, config)
