import jax.random as jr
import numpy as np
import pytest
import scipy.linalg

from hiprl.world.build import world_from
from hiprl.world.linear import default_linear


def matrices(task):
    return (np.asarray(x, np.float64) for x in (task.A, task.B, task.Q, task.R))


def simulated(task, gains, n=40_000):
    """Mean return of a = -K_t s and its standard error, by a plain NumPy loop."""
    rng = np.random.default_rng(5)
    A, B, Q, R = matrices(task)
    s = np.asarray(task.first_mean) + float(task.first_std) * rng.standard_normal((n, task.p))
    total = np.zeros(n)
    for K in gains:
        a = -s @ K.T
        total -= np.einsum("ni,ij,nj->n", s, Q, s) + np.einsum("ni,ij,nj->n", a, R, a)
        s = s @ A.T + a @ B.T + float(task.noise_std) * rng.standard_normal(s.shape)
    return total.mean(), total.std() / np.sqrt(n)


def test_the_closed_forms_agree_with_simulation():
    task = default_linear(noise_std=0.03)
    mean, error = simulated(task, task.optimal_gains())
    assert abs(mean - task.optimal_return()) < 4 * error
    K = 0.5 * task.stationary_gain()
    mean, error = simulated(task, [K] * task.H)
    assert abs(mean - task.expected_return(K)) < 4 * error


def test_the_stationary_gain_solves_the_riccati_equation():
    task = default_linear()
    A, B, Q, R = matrices(task)
    V = scipy.linalg.solve_discrete_are(A, B, Q, R)
    np.testing.assert_allclose(task.stationary_gain(), np.linalg.solve(R + B.T @ V @ B, B.T @ V @ A), rtol=1e-8)


def test_without_noise_the_optimum_is_the_least_squares_solution_over_all_actions():
    task = default_linear(noise_std=0.0)
    A, B, Q, R = matrices(task)
    H, p, q = task.H, task.p, task.q
    # s_t = A^t s_0 + sum_{i<t} A^(t-1-i) B a_i: minimise the cost over the stacked actions, for one s_0.
    powers = [np.linalg.matrix_power(A, t) for t in range(H)]
    F = np.zeros((H * p, H * q))
    for t in range(H):
        for i in range(t):
            F[t * p : (t + 1) * p, i * q : (i + 1) * q] = powers[t - 1 - i] @ B
    big_Q, big_R = np.kron(np.eye(H), Q), np.kron(np.eye(H), R)

    def cost(s_0):
        free = np.concatenate([P @ s_0 for P in powers])
        u = -np.linalg.solve(F.T @ big_Q @ F + big_R, F.T @ big_Q @ free)
        s = free + F @ u
        return s @ big_Q @ s + u @ big_R @ u

    mean, std = np.asarray(task.first_mean, np.float64), float(task.first_std)
    # The cost is quadratic in s_0, so its mean is exact from the ± points along each axis.
    spread = sum((cost(mean + std * e) + cost(mean - std * e) - 2 * cost(mean)) / 2 for e in np.eye(p))
    assert task.optimal_return() == pytest.approx(-(cost(mean) + spread), rel=1e-9)


def test_no_gain_beats_the_optimum_and_the_stationary_one_comes_close():
    task = default_linear()
    best, K = task.optimal_return(), task.stationary_gain()
    rng = np.random.default_rng(2)
    for _ in range(20):
        assert task.expected_return(K + 0.2 * rng.standard_normal(K.shape)) < best
    assert best - 0.01 < task.expected_return(K) < best
    assert task.expected_return(np.zeros_like(K)) < 2 * best


def test_executed_returns_of_the_optimal_actor_have_the_stated_mean_and_stay_inside_the_action_limits():
    world = world_from("linear")
    assert (world.p, world.q, world.H) == (3, 2, 31)
    actor = world.task.optimal_actor()
    taus = [world.roll_out(actor, key=jr.key(seed)) for seed in range(400)]
    returns = np.array([tau.true_return for tau in taus])
    error = returns.std() / np.sqrt(len(taus))
    assert abs(returns.mean() - world.task.expected_return(np.asarray(actor.gain))) < 4 * error
    assert max(np.abs(tau.actions).max() for tau in taus) < 0.8


def test_the_drift_of_the_system_left_alone_is_outside_the_unit_circle():
    assert np.abs(np.linalg.eigvals(np.asarray(default_linear().A))).max() > 1
