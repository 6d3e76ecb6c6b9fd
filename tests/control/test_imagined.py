import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.control.imagined import Chance, SearchReport, report_of, trials
from hiprl.control.policy import SquashedPolicy
from tests.control.known import M, known, quadratic, starts
from tests.data.samples import p, q

A = np.array([[0.9, 0.2, 0.0], [0.0, 0.8, 0.3], [0.1, 0.0, 0.7]])
B = np.array([[0.5, 0.0], [0.1, -0.4], [0.0, 0.6]])
STEPS, n = 11, 7


@pytest.fixture(scope="module")
def policy():
    return SquashedPolicy.draw(starts().scaler, q, hidden=(7,), activation="tanh", key=jr.key(2))


@pytest.fixture(scope="module")
def tried(policy):
    """Returns of the trial for a model and a reward."""

    @jax.jit
    def compiled(worlds, reward, first, key):
        return trials(worlds, policy, reward, ends, Chance.draw(first, M=M, n=n, steps=STEPS, key=key))

    return compiled


def ends(s, a, s_next):
    return s_next[0] > 1.0


REWARD = quadratic(Q=np.diag([1.0, 0.3, 0.2]), R=np.eye(q), G=0.2 * np.ones((q, p)), d=[0.1, 0.2, -0.4])


def by_loop(policy, s):
    """The return from s in the model without noise, one step after the other, until it ends."""
    total = 0.0
    for _ in range(STEPS):
        a = np.asarray(policy.mode(jnp.asarray(s, jnp.float32)), float)
        total += float(REWARD(jnp.asarray(s, jnp.float32), jnp.asarray(a, jnp.float32)))
        s = A @ s + B @ a
        if s[0] > 1.0:
            break
    return total


def test_a_trial_is_a_plain_rollout_without_exploration(policy, tried):
    first = jnp.asarray([[0.4, -0.3, 0.9]])  # one place to start, so that all trials are alike
    returns = np.asarray(tried(known(A=A, B=B).in_each_member(), REWARD, first, jr.key(1)))
    assert returns.shape == (M, n)
    np.testing.assert_allclose(returns, by_loop(policy, np.array([0.4, -0.3, 0.9])), rtol=1e-4)


def test_a_trial_stops_earning_where_it_ends(policy, tried):
    at_the_edge = jnp.asarray([[3.0, 3.0, 3.0]])
    returns = tried(known(A=A, B=B).in_each_member(), REWARD, at_the_edge, jr.key(1))
    one = float(REWARD(at_the_edge[0], policy.mode(at_the_edge[0])))
    np.testing.assert_allclose(returns, one, rtol=1e-5)


def test_trials_begin_where_episodes_begin(policy, tried):
    first = starts().first
    returns = np.asarray(tried(known(A=A, B=B).in_each_member(), REWARD, first, jr.key(1))).ravel()
    possible = np.array([by_loop(policy, np.asarray(s, float)) for s in first])
    assert (np.abs(returns[:, None] - possible[None]).min(1) < 1e-3).all()
    assert len(set(returns.round(4))) > 3


def test_a_report_is_the_mean_over_members_and_the_worst_of_them():
    report = report_of(jnp.array([[1.0, 3.0], [-5.0, 1.0], [10.0, 2.0]]))
    assert float(report.imagined) == 2 and float(report.worst) == -2 and report.finite
    assert not report_of(jnp.array([[1.0, jnp.nan]])).finite
    assert not SearchReport.nothing().finite
