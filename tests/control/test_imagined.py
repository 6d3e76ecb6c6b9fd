from dataclasses import replace

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.control.imagined import DOUBT, SHAKE, Chance, Doubt, SearchReport, doubtful_trials, report_of, trials
from hiprl.control.policy import SquashedPolicy
from hiprl.types import Dynamics, Prediction
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


class Apart(Dynamics):
    """Members that drift apart: the first up, the second down, in all entries."""

    def predict(self, s, a):
        return Prediction(s, jnp.full_like(s, 0.1), jnp.zeros_like(s))

    def members(self):
        return Drift(jnp.asarray([0.1, -0.1]))


class Drift(Dynamics):
    """s′ = s + rate + 0.01 Σ a."""

    rate: jax.Array

    def predict(self, s, a):
        return Prediction(s + self.rate + 0.01 * jnp.sum(a), jnp.zeros_like(s), jnp.zeros_like(s))

    def members(self):
        return jax.tree.map(lambda x: x[None], self)


def doubted(policy, f_tilde, reward, doubt, s_0):
    chance = Chance(jnp.broadcast_to(jnp.asarray(s_0), (M, n, p)), jnp.zeros((STEPS, M, n, p)))
    return np.asarray(jax.jit(lambda: doubtful_trials(f_tilde, policy, reward, ends, chance, doubt))())


def steady(member=0):
    """Which member, and no noise in actions."""
    return Doubt(jnp.broadcast_to(jnp.asarray(member), (STEPS, M, n)), jnp.zeros((STEPS, M, n, q)))


def test_where_members_agree_a_doubtful_trial_is_like_any_other(policy):
    returns = doubted(policy, known(A=A, B=B), REWARD, steady(), [0.4, -0.3, 0.9])
    np.testing.assert_allclose(returns, by_loop(policy, np.array([0.4, -0.3, 0.9])), rtol=1e-4)
    one = float(REWARD(jnp.full(p, 3.0), policy.mode(jnp.full(p, 3.0))))
    np.testing.assert_allclose(doubted(policy, known(A=A, B=B), REWARD, steady(), [3.0] * p), one, rtol=1e-5)


def test_a_doubtful_world_is_another_member_at_each_step_and_further_from_their_mean(policy):
    f_tilde = replace(known(), dynamics=Apart())
    which = np.random.default_rng(4).integers(0, 2, STEPS)
    doubt = Doubt(jnp.broadcast_to(jnp.asarray(which)[:, None, None], (STEPS, M, n)), jnp.full((STEPS, M, n, q), 5.0))
    s = -0.5 + np.concatenate([[0], np.cumsum(DOUBT * 0.1 * (1 - 2 * which) + 0.01 * q)])[:-1]  # actions are 1 at most
    assert s.max() < 1.0
    returns = doubted(policy, f_tilde, quadratic(Q=np.eye(p)), doubt, [-0.5] * p)
    np.testing.assert_allclose(returns, -p * np.sum(s**2), rtol=1e-4)


def test_doubt_is_any_member_and_noise_of_its_size():
    chance = Chance.draw(starts().first, M=M, n=n, steps=500, key=jr.key(1))
    doubt = Doubt.draw(chance, q=q, key=jr.key(2))
    assert np.mean(np.asarray(doubt.member)) == pytest.approx(0.5, abs=0.03) and set(np.unique(doubt.member)) == {0, 1}
    assert doubt.shake.shape == (500, M, n, q) and np.std(doubt.shake) == pytest.approx(SHAKE, rel=0.05)


def test_a_report_is_the_mean_over_members_and_the_worst_of_them():
    report = report_of(jnp.array([[1.0, 3.0], [-5.0, 1.0], [10.0, 2.0]]))
    assert float(report.imagined) == 2 and float(report.worst) == -2 and report.finite
    assert not report_of(jnp.array([[1.0, jnp.nan]])).finite
    assert not SearchReport.nothing().finite
