import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy.integrate

from hiprl.types import Actor
from hiprl.world.build import world_from
from hiprl.world.jax_world import JaxWorld
from hiprl.world.pendulum import SwingUp, tolerance
from tests.world.actors import Constant, uniform

INERTIA, WEIGHT, FRICTION = 0.3 * 0.5**2, 0.3 * 9.81 * 0.5, 0.005


class EnergyPump(Actor):
    """Adds energy until there is just enough to reach the top, then holds the pendulum there."""

    def act(self, s, *, key):
        cos, sin, omega = s
        missing = WEIGHT - (INERTIA * omega**2 / 2 + WEIGHT * cos)
        pump = jnp.clip(20 * missing * jnp.sign(omega), -1.0, 1.0)
        hold = jnp.clip(-5.0 * sin - 0.6 * omega, -1.0, 1.0)
        return jnp.where(cos > 0.93, hold, pump)[None]


def test_the_state_follows_the_equation_of_motion():
    task = SwingUp()
    f = jax.jit(lambda s, a, key: task.f(s, a, key))
    theta, omega, torque = 2.0, -1.3, 0.7
    s = jnp.array([np.cos(theta), np.sin(theta), omega], jnp.float32)
    for _ in range(40):
        s = f(s, jnp.array([torque]), jr.key(0))

    def motion(_, x):
        return x[1], (WEIGHT * np.sin(x[0]) + torque - FRICTION * x[1]) / INERTIA

    exact = scipy.integrate.solve_ivp(motion, (0, 40 / 80), (theta, omega), rtol=1e-9, atol=1e-9).y[:, -1]
    np.testing.assert_allclose(s, [np.cos(exact[0]), np.sin(exact[0]), exact[1]], atol=2e-4)


@pytest.mark.parametrize("action_cost", [0.0, 0.1, 0.2])
def test_doing_nothing_is_worth_nothing_and_trying_in_vain_costs(action_cost):
    world = JaxWorld(SwingUp(action_cost))
    nothing = world.roll_out(Constant(jnp.zeros(1)), key=jr.key(0))
    assert nothing.true_return == 0
    assert nothing.length == 400
    assert not nothing.terminated
    vain = world.roll_out(uniform(1), key=jr.key(1)).true_return
    assert vain == pytest.approx(-400 * 0.83 * action_cost, rel=0.1)  # |a| averages to 0.83 of the full price


@pytest.mark.parametrize(("action_cost", "at_least"), [(0.0, 200), (0.1, 180), (0.2, 160)])
def test_an_energy_controller_swings_it_up_at_every_price(action_cost, at_least):
    world = world_from(f"swing-up:action_cost={action_cost}")
    for seed in range(3):
        assert world.roll_out(EnergyPump(), key=jr.key(seed)).true_return > at_least


@pytest.mark.parametrize("a", [-1.0, 1.0])
def test_no_constant_torque_reaches_the_top(a):
    tau = JaxWorld(SwingUp()).roll_out(Constant(jnp.array([a])), key=jr.key(3))
    assert tau.states[:, 0].max() < 0.5
    assert tau.true_return < 1e-3


def test_the_reward_is_narrow_and_charges_for_torque():
    r = SwingUp(0.2).r
    free, full = jnp.array([0.05]), jnp.array([-1.0])
    top = jnp.array([1.0, 0.0, 0.4])
    assert r(top, free) == pytest.approx(1.0)
    assert r(top, full) == pytest.approx(0.8)
    assert r(jnp.array([0.85, 0.53, 0.0]), free) == pytest.approx(0.1, rel=1e-4)  # one margin off
    assert r(jnp.array([1.0, 0.0, -1.0]), free) == pytest.approx(0.1, rel=1e-4)
    assert r(jnp.array([0.0, 1.0, 0.0]), free) < 1e-12


def test_tolerance_is_one_inside_and_a_tenth_at_the_margin():
    inside = [tolerance(jnp.float32(x), low=-2.0, high=3.0, margin=0.7) for x in (-2.0, 0.4, 3.0)]
    assert inside == [1.0, 1.0, 1.0]
    for x in (-2.7, 3.7):
        assert tolerance(jnp.float32(x), low=-2.0, high=3.0, margin=0.7) == pytest.approx(0.1, rel=1e-4)


def test_anywhere_is_all_round_and_as_fast_as_a_fall_from_the_top():
    cos, sin, omega = np.asarray(SwingUp().anywhere(), float).T
    np.testing.assert_allclose(cos**2 + sin**2, 1.0, atol=1e-5)
    still, energy = omega == 0, INERTIA * omega**2 / 2 + WEIGHT * cos
    assert still.mean() == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(energy[~still], WEIGHT, rtol=1e-4)
    for which in (still, omega > 0, omega < 0):
        assert np.ptp(np.unwrap(np.sort(np.arctan2(sin[which], cos[which])))) > 6.1


def test_it_starts_hanging_all_but_still():
    s = jax.vmap(SwingUp().s_0)(jr.split(jr.key(4), 500))
    assert s[:, 0].max() < -0.99
    assert 0.007 < s[:, 1].std() < 0.013
    assert 0.007 < s[:, 2].std() < 0.013
