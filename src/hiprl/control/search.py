"""PolicySearch: π and η together, eq. (6), by the method that the config names."""

from __future__ import annotations

from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from hiprl.control.gradient import GradientConfig, gradient_search, new_gradient
from hiprl.control.imagined import Ends, SearchReport, SearchState, Starts
from hiprl.control.ppo import PPOConfig, new_ppo, ppo_search
from hiprl.data.trajectory_set import Trajectories
from hiprl.hallucinated import Hallucinated
from hiprl.models.network import Scaler, state_scaler
from hiprl.models.reward import EstimatedReward
from hiprl.models.usual import counts
from hiprl.types import Count, Key

SearchConfig: TypeAlias = GradientConfig | PPOConfig
SEEN_STATES = 8192  # as many as one search draws its starts from


@partial(jax.jit, static_argnames=("size", "config"))
def new_search(T: Trajectories, size: int, config: SearchConfig, *, key: Key) -> SearchState:
    """Where the first search begins: a policy of `size` outputs that does next to nothing, in the units of T."""
    new = new_gradient if isinstance(config, GradientConfig) else new_ppo
    return new(state_scaler(T), size, config, key=key)  # pyright: ignore[reportArgumentType]


@partial(jax.jit, static_argnames=("config",))
def search(
    f_tilde: Hallucinated,
    reward: EstimatedReward,
    ends: Ends | None,
    T: Trajectories,
    state: SearchState,
    config: SearchConfig,
    *,
    setbacks: Count | int = 0,
    anywhere: Float[Array, "n p"] | None = None,
    key: Key,
) -> tuple[SearchState, SearchReport]:
    """The policy, and its η, that is best in the hallucinated model: one compiled program.

    Args:
        f_tilde: the hallucinated model.
        reward: r̂.
        ends: when an imagined episode terminates; None for never.
        T: trajectories whose states imagined rollouts start from.
        state: where to start: the policy and value of an earlier search.
        config: the method and its settings.
        setbacks: earlier searches from `state` whose policy did worse in the world than that of `state`.
        anywhere: states that imagined rollouts start from as often, whether they were seen or not.
    """
    start_key, search_key = jr.split(key)
    rows = T.transitions()
    usual = counts(reward.of_steps(rows.s, rows.a), T)
    seen = jr.choice(start_key, rows.s, (SEEN_STATES,), p=usual)
    scaler = state_scaler(T)
    if anywhere is not None:
        seen = jnp.concatenate([seen, jnp.resize(anywhere, seen.shape)])
        scaler = Scaler.of(seen, jnp.ones(len(seen), bool))
    starts = Starts(seen, T.first_states(), scaler)
    H = T.rows.actions.shape[1]
    if isinstance(config, GradientConfig):
        more = {"H": H, "setbacks": jnp.asarray(setbacks), "key": search_key}
        return gradient_search(f_tilde, reward, reward.unit, ends, starts, state, config, **more)
    return ppo_search(f_tilde, reward, ends, starts, state, config, H=H, key=search_key)
