import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Array, Float

from hiprl.rollout import J, roll_out
from hiprl.types import Actor
from tests.data.samples import H, lengths, p, q, seeds, trajectory

A = jnp.array([[0.9, 0.1, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.3, 1.1]])
B = jnp.array([[0.4, 0.0], [0.1, -0.3], [0.0, 0.5]])


class Drawn(Actor):
    """A linear policy with noise."""

    gain: Float[Array, "q p"]

    def act(self, s, *, key):
        return jnp.tanh(self.gain @ s + jr.normal(key, (q,)))


def f(s, a, key):
    return A @ s + B @ a + 0.1 * jr.normal(key, (p,))


def r(s, a):
    return s[0] - a[1] ** 2


def by_loop(actor, s_0, H, terminates, key):
    """The same trajectory, one step after the other, in plain Python."""
    states, actions, rewards = [np.asarray(s_0)], [], []
    for _ in range(H):
        key, act_key, f_key = jr.split(key, 3)
        s = jnp.asarray(states[-1])
        a = actor.act(s, key=act_key)
        s_next = f(s, a, f_key)
        states.append(np.asarray(s_next))
        actions.append(np.asarray(a))
        rewards.append(float(r(s, a)))
        if terminates(s, a, s_next):
            return states, actions, rewards, True
    return states, actions, rewards, False


@pytest.fixture(scope="module")
def rolled():
    """A compiled roll-out that ends where the first entry of the state passes `edge`."""

    @jax.jit
    def compiled(actor, s_0, edge, key):
        ends = lambda s, a, s_next: s_next[0] > edge
        return roll_out(f, actor, s_0, H=H, r=r, terminates=ends, key=key)

    return compiled


@given(seeds, st.floats(-1, 3))
def test_a_scan_gives_what_a_loop_gives(rolled, seed, edge):
    rng = np.random.default_rng(seed)
    actor, s_0 = Drawn(jnp.asarray(rng.normal(size=(q, p)), jnp.float32)), jnp.asarray(rng.normal(size=p), jnp.float32)
    tau = jax.tree.map(np.asarray, rolled(actor, s_0, edge, jr.key(seed)))
    states, actions, rewards, ended = by_loop(actor, s_0, H, lambda s, a, s_next: s_next[0] > edge, jr.key(seed))
    n = len(actions)
    assert int(tau.length) == n and bool(tau.terminated) == ended
    np.testing.assert_allclose(tau.states[: n + 1], states, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(tau.actions[:n], actions, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(tau.rewards[:n], rewards, rtol=1e-4, atol=1e-4)
    # after the end the state stands still
    assert (tau.states[n + 1 :] == tau.states[n]).all()


def test_running_out_of_time_is_no_termination():
    tau = roll_out(f, Drawn(jnp.ones((q, p))), jnp.ones(p), H=H, r=r, key=jr.key(3))
    assert int(tau.length) == H and not tau.terminated
    at_the_end = lambda s, a, s_next: jnp.asarray(True)
    tau = roll_out(f, Drawn(jnp.ones((q, p))), jnp.ones(p), H=H, r=r, terminates=at_the_end, key=jr.key(3))
    assert int(tau.length) == 1 and tau.terminated


@given(seeds, lengths)
def test_J_is_the_plain_sum_over_the_executed_steps(seed, n):
    tau = trajectory(np.random.default_rng(seed), length=n)
    s, a = np.asarray(tau.states, float), np.asarray(tau.actions, float)
    np.testing.assert_allclose(float(J(tau, r)), sum(s[t, 0] - a[t, 1] ** 2 for t in range(n)), atol=2e-5)


def test_J_has_a_gradient_where_the_padding_is_nan():
    tau = trajectory(np.random.default_rng(5), length=3)
    slope = jax.grad(lambda w: J(tau, lambda s, a: w * jnp.sqrt(jnp.sum(s**2) + jnp.sum(a**2) + 1.0)))(2.0)
    assert np.isfinite(slope)
