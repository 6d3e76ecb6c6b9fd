"""EstReward(P, T), by the model that the config names."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from hiprl.data.preference import Preferences
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.models.answers import estimate_from_answers
from hiprl.models.evidence import most_steps
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
    return estimate_additive_reward(P, T, config, longest=1)


def estimate_reward(
    P: Preferences, T: Trajectories, before: EstimatedReward | None, config: RewardConfig
) -> EstimatedReward:
    """The reward after the answers in P; networks go on from the weights in `before`, others begin anew. Eq. (7).

    Not to be traced.

    Raises:
        InputError: networks were given answers that are not numbers about whole trajectories.
    """
    numbers = P.only_numbers()
    if isinstance(config, NetworkConfig):
        if not numbers or most_steps(P, T) < T.rows.actions.shape[1]:
            raise InputError(
                "got answers that are not numbers about whole trajectories; the paper's reward network learns from "
                "such numbers alone. Take the default reward, or `--judge exact` without `--clip`."
            )
        assert isinstance(before, NetworkReward)
        return estimate_network_reward(P, T, before, config)
    if numbers:
        return estimate_additive_reward(P, T, config)
    several = len(np.unique(np.asarray(P.judge)[: int(P.count)])) > 1  # by NumPy: JAX would compile for each count
    again = len(set(P.asked())) < int(P.count)
    return estimate_from_answers(P, T, config.kernels, learn_mistakes=several or again)
