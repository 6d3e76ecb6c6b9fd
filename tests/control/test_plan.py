from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.control.gradient import GradientConfig, new_gradient
from hiprl.control.imagined import SearchState
from hiprl.control.plan import Follow, Mpc, Noisy, PlanConfig, planned
from hiprl.control.policy import Value
from hiprl.models.network import MLP
from tests.control.known import known, quadratic, starts
from tests.data.samples import p, q

GAMMA = 0.9
PLAN = PlanConfig(kind="mpc", proposals=32, elites=5, iterations=4, horizon=3, spread=0.4)
B = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
TWO = np.array([0.3, -0.5])


def state_of(size=q, *, loud=30.0):
    """A policy that does something, and a value of nothing."""
    state = new_gradient(starts().scaler, size, GradientConfig(hidden=(7,)), key=jr.key(1))
    policy = eqx.tree_at(lambda policy: policy.net.weights[-1], state.policy, loud * state.policy.net.weights[-1])
    value = eqx.tree_at(lambda v: v.net.weights[-1], state.value, jnp.zeros_like(state.value.net.weights[-1]))
    return SearchState(policy, value)


def actor(kind, f_tilde, reward, *, state=None, ends=None, plan=PLAN):
    state = state or state_of(q + f_tilde.eta_size)
    return planned(state, f_tilde, reward, ends, replace(plan, kind=kind), q=q, gamma=GAMMA)


@pytest.fixture(scope="module")
def act():
    return jax.jit(lambda actor, s, key: actor.act(s, key=key))


def discounted(reward, s, sequence, A=None):
    """What a sequence of actions is worth from s in the model without noise."""
    A, total = np.zeros((p, p)) if A is None else A, 0.0
    for t, a in enumerate(sequence):
        total += GAMMA**t * float(reward(jnp.asarray(s, jnp.float32), jnp.asarray(a, jnp.float32)))
        s = A @ np.asarray(s, float) + B @ np.asarray(a, float)
    return total


def test_a_plan_of_none_follows_the_mode_and_a_sample_draws(act):
    state, s = state_of(), jnp.array([0.3, -0.4, 0.6])
    assert isinstance(actor("none", known(B=B), quadratic(), state=state), Follow)
    a = act(actor("none", known(B=B), quadratic(), state=state), s, jr.key(1))
    np.testing.assert_allclose(a, state.policy.mode(s), rtol=1e-5)
    drawn = act(actor("sample", known(B=B), quadratic(), state=state), s, jr.key(1))
    np.testing.assert_allclose(drawn, state.policy.sample(s, key=jr.key(1)), rtol=1e-5)


def test_while_it_learns_an_actor_does_nearly_what_the_plan_says(act):
    state, s = state_of(loud=100.0), jnp.array([0.3, -0.4, 0.6])
    plain = actor("none", known(B=B), quadratic(), state=state)
    drawn = np.asarray(jax.vmap(lambda key: Noisy(plain, 0.1).act(s, key=key))(jr.split(jr.key(1), 4000)))
    a = np.asarray(act(plain, s, jr.key(1)))
    inside = np.abs(a) < 0.6
    assert (np.abs(drawn) <= 1).all() and inside.any()
    np.testing.assert_allclose(drawn.mean(axis=0)[inside], a[inside], atol=0.01)
    np.testing.assert_allclose(drawn.std(axis=0)[inside], 0.1, rtol=0.1)
    np.testing.assert_allclose(act(Noisy(plain, 0.0), s, jr.key(1)), a)


@pytest.mark.parametrize("kind", ["none", "sample", "mpc"])
def test_only_the_action_is_executed_and_never_eta(act, kind):
    f_tilde = known(B=B, sigma=0.5, mode="eta_policy")
    a = act(actor(kind, f_tilde, quadratic(Q=np.eye(p))), jnp.array([0.3, -0.4, 0.6]), jr.key(1))
    assert a.shape == (q,) and (np.abs(a) <= 1).all()


def test_planning_finds_the_best_of_a_known_quadratic(act):
    # two terms: the action's own cost pulls to 0, the reward of the next state pulls to the target
    reward = quadratic(Q=np.eye(p), R=np.eye(q), d=[*TWO, 0.0])
    long = PlanConfig(kind="mpc", proposals=128, elites=10, iterations=8, horizon=2, spread=0.4)
    planner = actor("mpc", known(B=B), reward, plan=long)
    # max over a of -a² - gamma (a - d)²
    best = GAMMA * TWO / (1 + GAMMA)
    np.testing.assert_allclose(act(planner, jnp.zeros(p), jr.key(1)), best, atol=0.04)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_in_the_model_a_plan_is_never_worse_than_the_policy(act, seed):
    rng = np.random.default_rng(seed)
    reward = quadratic(Q=np.diag(rng.uniform(0, 1, p)), R=np.diag(rng.uniform(0, 1, q)), c=rng.uniform(-1, 1, q))
    one = PlanConfig(kind="mpc", proposals=32, elites=5, iterations=4, horizon=1, spread=0.4)
    planner = actor("mpc", known(B=B), reward, plan=one)  # one step: what is executed is the whole plan
    s = jnp.asarray(rng.normal(size=p), jnp.float32)
    plan, own = act(planner, s, jr.key(seed)), planner.state.policy.mode(s)
    assert discounted(reward, s, [plan]) >= discounted(reward, s, [own]) - 1e-5


def test_with_nothing_to_gain_the_policy_is_left_alone(act):
    # no proposal is better than another: the policy's own sequence comes first
    state, s = state_of(), jnp.array([0.3, -0.4, 0.6])
    np.testing.assert_allclose(
        act(actor("mpc", known(B=B), quadratic(), state=state), s, jr.key(1)), state.policy.mode(s), atol=1e-5
    )


def test_the_value_stands_for_what_follows_the_plan(act):
    # no reward within the horizon: the value alone says that the first entry should be large
    state = state_of(loud=0.0)
    value = Value(MLP((jnp.array([[1.0], [0.0], [0.0]]),), (jnp.zeros(1),), "elu"), starts().scaler, jnp.ones(()))
    one = PlanConfig(kind="mpc", proposals=64, elites=5, iterations=6, horizon=1, spread=0.5)
    planner = actor("mpc", known(B=B), quadratic(), state=SearchState(state.policy, value), plan=one)
    a = act(planner, jnp.zeros(p), jr.key(1))
    assert float(a[0]) > 0.9 and abs(float(a[1])) < 0.9


def test_nothing_is_earned_after_an_end(act):
    # from the second step on there would be a fortune, but every episode ends with the first
    fortune = quadratic(Q=-100 * np.eye(p), R=np.eye(q), c=TWO)
    ends = jax.tree_util.Partial(lambda s, a, s_next: jnp.asarray(True))
    a = act(
        actor("mpc", known(B=B), fortune, ends=ends, plan=PlanConfig(kind="mpc", proposals=128, iterations=8)),
        jnp.zeros(p),
        jr.key(1),
    )
    np.testing.assert_allclose(a, TWO, atol=0.06)


def test_the_same_key_gives_the_same_plan(act):
    planner = actor("mpc", known(B=B, noise=0.1), quadratic(Q=np.eye(p), d=[1.0, 1.0, 1.0]))
    assert isinstance(planner, Mpc)
    s = jnp.array([0.3, -0.4, 0.6])
    one, other, third = (np.asarray(act(planner, s, jr.key(seed))) for seed in (1, 1, 2))
    assert (one == other).all() and (one != third).any()
