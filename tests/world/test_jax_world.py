from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.errors import WorldError
from hiprl.world.jax_world import JaxWorld
from hiprl.world.linear import default_linear
from hiprl.world.task import Task
from hiprl.world.termination import never
from tests.world.actors import uniform


class Walk(Task):
    """s grows by more than the action takes away, and the episode ends past `edge`."""

    edge: jax.Array
    growth: jax.Array
    name: ClassVar[str] = "walk"
    ends: ClassVar[bool] = True
    p: ClassVar[int] = 2
    q: ClassVar[int] = 1
    H: ClassVar[int] = 17

    def f(self, s, a, key):
        return self.growth * s + 0.1 * a[0] + 1.0

    def r(self, s, a):
        return s[0]

    def s_0(self, key):
        return jr.uniform(key, (2,))

    def terminates(self, s, a, s_next):
        return s_next[0] > self.edge


def walk(edge, growth=1.0):
    return JaxWorld(Walk(jnp.float32(edge), jnp.float32(growth)))


def test_an_episode_stops_where_the_task_ends_it():
    tau = walk(5.0).roll_out(uniform(1), key=jr.key(0))
    n = int(tau.length)
    assert tau.terminated
    assert 3 < n < 8
    assert tau.states[n, 0] > 5.0
    assert (tau.states[:n, 0] <= 5.0).all()
    assert tau.states.shape == (18, 2)


def test_running_out_of_time_is_no_termination():
    tau = walk(1e6).roll_out(uniform(1), key=jr.key(0))
    assert tau.length == 17
    assert not tau.terminated


def test_the_same_key_gives_the_same_episode_and_another_key_another():
    world = JaxWorld(default_linear())
    one, same, other = (world.roll_out(uniform(2), key=jr.key(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.states, same.states)
    np.testing.assert_array_equal(one.actions, same.actions)
    assert not np.array_equal(one.states[0], other.states[0])


def test_each_state_follows_from_the_one_before_and_pays_the_tasks_reward():
    task = default_linear(noise_std=0.0)
    tau = JaxWorld(task, horizon=7).roll_out(uniform(2), key=jr.key(3))
    for t in range(7):
        s, a = np.asarray(tau.states[t]), np.asarray(tau.actions[t])
        np.testing.assert_allclose(tau.states[t + 1], np.asarray(task.A) @ s + np.asarray(task.B) @ a, atol=1e-5)
        paid = -(s @ np.asarray(task.Q) @ s + a @ np.asarray(task.R) @ a)
        assert tau.rewards[t] == pytest.approx(paid, rel=1e-4, abs=1e-6)


def test_a_task_that_never_ends_is_known_to():
    assert JaxWorld(default_linear()).terminates is never
    assert not JaxWorld(default_linear()).ends
    assert walk(1.0).ends
    assert walk(1.0).terminates(jnp.zeros(2), jnp.zeros(1), jnp.full(2, 1.5))


def test_a_state_that_is_not_finite_is_reported_in_three_parts():
    with pytest.raises(WorldError, match=r"walk gave .* not finite; .* must stay .* real numbers\. Look at"):
        walk(jnp.inf, growth=1e30).roll_out(uniform(1), key=jr.key(0))
