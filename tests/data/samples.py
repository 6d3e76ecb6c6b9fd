"""Trajectories for tests: sizes are different primes, and padding holds NaN."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

from hiprl.data.preference import Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories

p, q, H, N, M = 3, 2, 7, 11, 5


def trajectory(rng, *, length=H, terminated=False, padding=np.nan, horizon=H, low=-2.0, high=3.0):
    """Random states, actions and rewards; what lies past `length` holds `padding`."""
    states = rng.uniform(low, high, (horizon + 1, p))
    actions = rng.uniform(-1, 1, (horizon, q))
    rewards = rng.uniform(low, high, horizon)
    states[length + 1 :], actions[length:], rewards[length:] = padding, padding, padding
    return Trajectory(
        states=jnp.asarray(states, jnp.float32),
        actions=jnp.asarray(actions, jnp.float32),
        rewards=jnp.asarray(rewards, jnp.float32),
        length=jnp.asarray(length, jnp.int32),
        terminated=jnp.asarray(terminated),
    )


def set_of(taus, *, capacity=N):
    """T with these trajectories; the rows that are not filled hold NaN."""
    T = Trajectories.empty(capacity, H=taus[0].actions.shape[0], p=p, q=q)
    for tau in taus:
        T = T.add(tau)
    return dirty(T)


def dirty(T):
    """T with NaN in the states, actions and rewards of the rows past its count."""

    def spoil(x):
        return jnp.where(T.filled.reshape(-1, *[1] * (x.ndim - 1)), x, jnp.nan) if x.dtype == jnp.float32 else x

    return Trajectories(jax.tree.map(spoil, T.rows), T.count)


def clean(T):
    """T with zeros wherever it holds NaN."""
    return jax.tree.map(lambda x: jnp.where(jnp.isnan(x), 0.0, x) if x.dtype == jnp.float32 else x, T)


def answers(pairs, g, *, capacity=N):
    """P with these answers."""
    P = Preferences.empty(capacity)
    for (i, j), x in zip(pairs, g, strict=True):
        P = P.add(jnp.asarray(x, jnp.float32), jnp.asarray(i, jnp.int32), jnp.asarray(j, jnp.int32))
    return P


seeds = st.integers(0, 2**32 - 1)
lengths = st.integers(1, H)
