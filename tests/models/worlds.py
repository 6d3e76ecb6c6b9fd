"""Data for tests of models: a linear world with noise, and rewards that are known."""

import jax.numpy as jnp
import numpy as np

from hiprl.data.trajectory import Trajectory
from tests.data.samples import p, q, set_of

A = np.array([[0.95, 0.2, 0.0], [-0.1, 0.9, 0.2], [0.05, 0.0, 0.8]])
B = np.array([[0.3, 0.0], [0.2, 0.1], [0.0, 0.4]])
NOISE = 0.05


def linear_trajectory(rng, *, H, length=None, noise=NOISE, terminated=False, spread=1.0):
    """A trajectory of s′ = A s + B a + noise under random actions; NaN past its length."""
    length = H if length is None else length
    states, actions = np.full((H + 1, p), np.nan), np.full((H, q), np.nan)
    states[0] = rng.normal(0, spread, p)
    for t in range(length):
        actions[t] = rng.uniform(-1, 1, q)
        states[t + 1] = A @ states[t] + B @ actions[t] + noise * rng.normal(size=p)
    return Trajectory(
        states=jnp.asarray(states, jnp.float32),
        actions=jnp.asarray(actions, jnp.float32),
        rewards=jnp.full(H, jnp.nan),
        length=jnp.asarray(length, jnp.int32),
        terminated=jnp.asarray(terminated),
    )


def linear_set(seed, lengths, *, H, capacity=None, noise=NOISE):
    """T with trajectories of these lengths, from the linear world."""
    rng = np.random.default_rng(seed)
    taus = [linear_trajectory(rng, H=H, length=n, noise=noise) for n in lengths]
    return set_of(taus, capacity=capacity or len(taus) + 2)


def steps_of(T, i):
    """States and actions of the executed steps of trajectory i, as float64."""
    n = int(T.rows.length[i])
    return np.asarray(T.rows.states[i], float)[:n], np.asarray(T.rows.actions[i], float)[:n]
