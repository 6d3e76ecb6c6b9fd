"""A linear system with a quadratic reward: the one world whose optimum is known in closed form."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float

from hiprl.types import Action, Actor, Flag, Key, Scalar, State
from hiprl.world.task import Task


class Linear(Task):
    """s′ = A s + B a + noise and r = -(sᵀ Q s + aᵀ R a).

    With the values of `default_linear`, optimal actions stay well inside [-1, 1], so the limit on actions
    does not matter to the optimum. The closed forms are computed in float64 on the host: a Riccati recursion
    in float32 loses the digits that a comparison with sampled returns needs.
    """

    A: Float[Array, "p p"]
    B: Float[Array, "p q"]
    Q: Float[Array, "p p"]
    R: Float[Array, "q q"]
    first_mean: State
    """Mean of s_0."""
    first_std: Scalar
    """Standard deviation of each entry of s_0."""
    noise_std: Scalar
    """Standard deviation of the noise on each entry of s′."""
    horizon: int = eqx.field(static=True)
    """H, where nobody asks for another number."""
    name: ClassVar[str] = "linear"
    ends: ClassVar[bool] = False

    @property
    def p(self) -> int:
        return self.B.shape[0]

    @property
    def q(self) -> int:
        return self.B.shape[1]

    @property
    def H(self) -> int:
        return self.horizon

    def f(self, s: State, a: Action, key: Key) -> State:
        return self.A @ s + self.B @ a + self.noise_std * jr.normal(key, s.shape)

    def r(self, s: State, a: Action) -> Scalar:
        return -(s @ self.Q @ s + a @ self.R @ a)

    def s_0(self, key: Key) -> State:
        return self.first_mean + self.first_std * jr.normal(key, self.first_mean.shape)

    def terminates(self, s: State, a: Action, s_next: State) -> Flag:
        return jnp.asarray(False)

    def optimal_return(self) -> float:
        """J*: expected return of the best policy over H steps, which may depend on the step.

        Source: finite-horizon Riccati recursion; Bertsekas, Dynamic Programming and Optimal Control I,
            section 3.1.
        """
        return self._expected_return(self.optimal_gains())

    def optimal_gains(self) -> np.ndarray:
        """K_t for t = 0 .. H-1 of the best policy, a = -K_t s; shape (H, q, p)."""
        V, gains = np.zeros((self.p, self.p)), []
        for _ in range(self.H):
            gain, V = self._riccati(V)
            gains.append(gain)
        return np.stack(gains[::-1])

    def stationary_gain(self) -> np.ndarray:
        """The gain K, shape (q, p), that is best for an endless episode; over H steps it is just below J*.

        Source: the fixed point of the same recursion (discrete algebraic Riccati equation).
        """
        V, before, gain = np.zeros((self.p, self.p)), None, np.zeros((self.q, self.p))
        while before is None or np.abs(V - before).max() > 1e-12 * np.abs(V).max():
            before = V
            gain, V = self._riccati(V)
        return gain

    def optimal_actor(self) -> LinearActor:
        """The policy a = -K s with the stationary gain, cut to [-1, 1]."""
        return LinearActor(jnp.asarray(self.stationary_gain(), jnp.float32))

    def expected_return(self, gain: np.ndarray) -> float:
        """Exact J of a = -`gain` s over H steps, noise and spread of s_0 included; `gain` has shape (q, p).

        Source: V_t = Q + Kᵀ R K + (A - B K)ᵀ V_{t+1} (A - B K), V_H = 0.
        """
        return self._expected_return(np.broadcast_to(gain, (self.H, self.q, self.p)))

    def _expected_return(self, gains: np.ndarray) -> float:
        A, B, Q, R, mean = _float64(self.A, self.B, self.Q, self.R, self.first_mean)
        V, cost_of_noise = np.zeros((self.p, self.p)), 0.0
        for K in gains[::-1]:
            cost_of_noise += float(self.noise_std) ** 2 * np.trace(V)
            closed = A - B @ K
            V = Q + K.T @ R @ K + closed.T @ V @ closed
        return float(-(mean @ V @ mean + float(self.first_std) ** 2 * np.trace(V) + cost_of_noise))

    def _riccati(self, V: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The best gain where V is the cost to go after the step, and the cost to go before it."""
        A, B, Q, R = _float64(self.A, self.B, self.Q, self.R)
        gain = np.linalg.solve(R + B.T @ V @ B, B.T @ V @ A)
        return gain, Q + A.T @ V @ (A - B @ gain)


class LinearActor(Actor):
    """a = -K s, cut to [-1, 1]."""

    gain: Float[Array, "q p"]

    def act(self, s: State, *, key: Key) -> Action:
        return jnp.clip(-self.gain @ s, -1.0, 1.0)


def default_linear(noise_std: float = 0.02) -> Linear:
    """Three states, two actions, 31 steps; left alone it drifts away slowly (A has an eigenvalue above 1)."""
    return Linear(
        A=jnp.array([[1.01, 0.2, 0.0], [-0.1, 0.95, 0.2], [0.05, 0.0, 0.9]]),
        B=jnp.array([[0.1, 0.0], [0.3, 0.1], [0.0, 0.4]]),
        Q=jnp.diag(jnp.array([1.0, 0.5, 0.3])),
        R=jnp.diag(jnp.array([0.7, 0.4])),
        first_mean=jnp.array([0.5, -0.3, 0.2]),
        first_std=jnp.float32(0.05),
        noise_std=jnp.float32(noise_std),
        horizon=31,
    )


def _float64(*arrays: Array) -> list[np.ndarray]:
    return [np.asarray(x, np.float64) for x in arrays]
