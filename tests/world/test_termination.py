"""The rules must agree with the environments themselves, step by step."""

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.world.quiet import quiet
from hiprl.world.termination import Leaves, ReachesGoal, known_rule, never


def made(name, **kwargs):
    with quiet():
        return gym.make(name, disable_env_checker=True, **kwargs)


def seen(env, steps, seed=7):
    """(s, a, s′, terminated): episodes with random actions and with constant ones take turns."""
    rng = np.random.default_rng(seed)
    low, high = env.action_space.low, env.action_space.high
    rows, s, episode = [], None, 0
    with quiet():
        for _ in range(steps):
            if s is None:
                s, _ = env.reset(seed=int(rng.integers(2**31)))
                episode += 1
                constant = rng.choice([low, high, 0 * low])
            a = rng.uniform(low, high) if episode % 2 else constant
            a = a.astype(np.float32)
            s_next, _, terminated, truncated, _ = env.step(a)
            rows.append((s.copy(), a, s_next.copy(), terminated))
            s = None if terminated or truncated else s_next
    s, a, s_next, terminated = zip(*rows, strict=True)
    return *(jnp.asarray(np.stack(x), jnp.float32) for x in (s, a, s_next)), np.asarray(terminated)


def agrees(env, steps):
    s, a, s_next, terminated = seen(env, steps)
    rule = known_rule(env)
    assert rule is not None
    np.testing.assert_array_equal(jax.jit(jax.vmap(rule))(s, a, s_next), terminated)
    return terminated


@pytest.mark.parametrize("version", ["v4", "v5"])
@pytest.mark.parametrize(
    ("name", "steps", "fewest_ends"),
    [
        ("InvertedPendulum", 5000, 50),
        ("InvertedDoublePendulum", 5000, 50),
        ("Hopper", 2000, 20),
        ("Walker2d", 2000, 20),
        ("Ant", 1500, 1),
        ("Humanoid", 1000, 10),
    ],
)
def test_a_rule_says_the_end_at_the_very_steps_where_the_environment_does(name, version, steps, fewest_ends):
    terminated = agrees(made(f"{name}-{version}"), steps)
    assert terminated.sum() >= fewest_ends
    assert not terminated.all()


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("HalfCheetah-v4", 1500),
        ("HalfCheetah-v5", 1500),
        ("Swimmer-v4", 1500),
        ("Swimmer-v5", 1500),
        ("Reacher-v4", 1500),
        ("Reacher-v5", 1500),
        ("Pusher-v5", 1500),
        ("HumanoidStandup-v5", 300),
        ("Pendulum-v1", 1500),
    ],
)
def test_what_never_ends_is_known_to_never_end(name, steps):
    env = made(name)
    assert known_rule(env) is never
    assert not agrees(env, steps).any()


def test_the_mountain_car_ends_at_its_goal_when_it_is_fast_enough():
    env = made("MountainCarContinuous-v0", goal_velocity=0.01)
    rule = jax.jit(known_rule(env))
    ends = []
    for seed in range(5):
        s, _ = env.reset(seed=seed)
        for _ in range(300):
            a = np.sign(s[1:]).astype(np.float32)  # push the way it moves
            s_next, _, terminated, _, _ = env.step(a)
            assert bool(rule(s, a, s_next)) == terminated
            s = s_next
            ends.append(terminated)
            if terminated:
                break
    assert sum(ends) == 5
    assert not rule(jnp.zeros(2), jnp.zeros(1), jnp.array([0.5, 0.005]))


@pytest.mark.parametrize(
    ("name", "kwargs"),
    [
        ("Hopper-v5", {"healthy_z_range": (1.1, 1.4), "healthy_angle_range": (-0.05, 0.07)}),
        ("Hopper-v5", {"healthy_state_range": (-3.0, 2.0)}),
        ("Hopper-v5", {"exclude_current_positions_from_observation": False}),
        ("Walker2d-v5", {"exclude_current_positions_from_observation": False, "healthy_z_range": (1.1, 2.0)}),
        ("Ant-v5", {"exclude_current_positions_from_observation": False, "healthy_z_range": (0.5, 0.9)}),
        ("Ant-v5", {"include_cfrc_ext_in_observation": False, "healthy_z_range": (0.5, 0.9)}),
        ("Humanoid-v5", {"healthy_z_range": (1.2, 1.5), "include_cinert_in_observation": False}),
    ],
)
def test_a_rule_follows_the_arguments_of_the_environment(name, kwargs):
    assert agrees(made(name, **kwargs), 500).any()


@pytest.mark.parametrize("name", ["Hopper-v5", "Walker2d-v4", "Ant-v5", "Humanoid-v5"])
def test_an_environment_told_not_to_end_when_unhealthy_never_ends(name):
    assert known_rule(made(name, terminate_when_unhealthy=False)) is never


def test_nothing_is_claimed_where_observations_are_changed_or_the_class_is_not_gymnasiums_own():
    from gymnasium.envs.mujoco.hopper_v5 import HopperEnv

    class Mine(HopperEnv):
        pass

    with quiet():
        assert known_rule(Mine()) is None
        assert known_rule(HopperEnv()) is not None
    hopper = made("Hopper-v5")
    assert known_rule(gym.wrappers.NormalizeObservation(hopper)) is None
    two, three = np.float32(2), np.float32(3)
    assert known_rule(gym.wrappers.RescaleAction(hopper, -two, three)) is not None
    assert known_rule(made("CartPole-v1")) is None


def test_a_double_pendulum_of_other_lengths_is_not_known(tmp_path):
    env = made("InvertedDoublePendulum-v5")
    longer = tmp_path / "inverted_double_pendulum.xml"
    with open(env.unwrapped.fullpath) as f:
        longer.write_text(f.read().replace("0 0 0.6", "0 0 0.7"))
    assert known_rule(made("InvertedDoublePendulum-v5", xml_file=str(longer))) is None


def test_a_state_that_is_not_finite_ends_the_episode():
    rule = Leaves(intervals=((1, -0.2, 0.2),), closed=True)
    s, a = jnp.zeros(3), jnp.zeros(1)
    assert not rule(s, a, jnp.array([5.0, 0.2, 5.0]))
    for bad in (jnp.nan, jnp.inf):
        for entry in range(3):
            assert rule(s, a, s.at[entry].set(bad))


def test_equal_rules_are_one_static_argument():
    one, same = (known_rule(made("Walker2d-v5")) for _ in range(2))
    assert one == same
    assert hash(one) == hash(same)
    assert hash(ReachesGoal(0.45, 0.0)) == hash(ReachesGoal(0.45, 0.0))
