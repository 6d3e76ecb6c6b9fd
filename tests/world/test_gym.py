import gymnasium as gym
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from gymnasium import spaces

from hiprl.errors import InputError, WorldError
from hiprl.world.build import world_from
from hiprl.world.gym import GymWorld
from hiprl.world.termination import never
from tests.world.actors import Constant, uniform


class Corridor(gym.Env):
    """Counts its steps in s; each behaviour that can go wrong has a switch."""

    observation_space = spaces.Box(-np.inf, np.inf, (3,), np.float64)
    action_space = spaces.Box(np.array([-2.0, 1.0]), np.array([4.0, 2.0]), dtype=np.float64)

    def __init__(self, **behaviour):
        self.does = behaviour
        self.executed = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        self.start = self.np_random.uniform(-1, 1)
        self.buffer = np.array([self.start, 0.0, 0.0])
        if "reset" in self.does:
            return self.does["reset"]()
        return self.buffer, {}

    def step(self, a):
        self.executed.append(a)
        self.t += 1
        self.buffer[1] = self.t  # the same memory each time, as some environments do
        if "step" in self.does and self.t == 5:
            return self.does["step"](self)
        terminated = self.t == self.does.get("terminate_at")
        truncated = self.t == self.does.get("truncate_at")
        return self.buffer, self.does.get("reward", 0.5), terminated, truncated, {}


def corridor(horizon=11, **behaviour):
    return GymWorld(Corridor(**behaviour), horizon=horizon)


def test_states_actions_and_rewards_are_those_that_were_executed():
    world = corridor()
    tau = world.roll_out(uniform(2), key=jr.key(1))
    assert tau.length == 11
    assert not tau.terminated
    np.testing.assert_array_equal(tau.states[:, 1], np.arange(12))
    assert tau.true_return == 5.5
    executed = np.stack(world.env.executed)
    np.testing.assert_allclose(executed, [1.0, 1.5] + np.asarray(tau.actions) * [3.0, 0.5], rtol=1e-6)


@pytest.mark.parametrize("corner", [[-1.0, 1.0], [1.0, -1.0]])
def test_extreme_actions_become_the_bounds_exactly(corner):
    world = corridor()
    world.roll_out(Constant(jnp.array(corner)), key=jr.key(0))
    expected = [[-2.0, 1.0], [4.0, 2.0]]
    np.testing.assert_array_equal(world.env.executed[0], [expected[corner[0] > 0][0], expected[corner[1] > 0][1]])


def test_termination_and_truncation_are_kept_apart():
    for behaviour, length, terminated in (
        ({"terminate_at": 7}, 7, True),
        ({"truncate_at": 7}, 7, False),
        ({"terminate_at": 7, "truncate_at": 7}, 7, True),
        ({}, 11, False),
        ({"terminate_at": 11}, 11, True),
    ):
        tau = corridor(**behaviour).roll_out(uniform(2), key=jr.key(2))
        assert (int(tau.length), bool(tau.terminated)) == (length, terminated)
        assert tau.states.shape == (12, 3)
        assert tau.actions.shape == (11, 2)


@pytest.mark.parametrize("reward", [None, float("nan")])
def test_an_environment_without_a_reward_gives_nan(reward):
    tau = corridor(reward=reward).roll_out(uniform(2), key=jr.key(2))
    assert np.isnan(tau.rewards).all()
    assert np.isfinite(tau.states).all()


@pytest.mark.parametrize("reward", [2, np.float32(2), np.array(2.0), np.array([2.0])], ids=repr)
def test_a_reward_may_be_any_single_number(reward):
    assert corridor(reward=reward).roll_out(uniform(2), key=jr.key(2)).true_return == 22


def test_the_same_key_gives_the_same_episode_and_another_key_another():
    world = world_from("Hopper-v5")
    one, other, same = (world.roll_out(uniform(3), key=jr.key(seed)) for seed in (5, 6, 5))
    for ours, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(same), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert not np.array_equal(one.states[0], other.states[0])
    assert not np.array_equal(one.actions[0], one.actions[1])


def test_an_episode_equals_a_plain_loop_over_the_environment():
    world = world_from("InvertedPendulum-v5")
    tau = world.roll_out(uniform(1), key=jr.key(8))
    env = gym.make("InvertedPendulum-v5")
    env.reset(seed=int(jr.bits(jr.split(jr.key(8))[0])))
    n = int(tau.length)
    for t in range(n):
        s, reward, terminated, _, _ = env.step(3.0 * np.asarray(tau.actions[t]))
        np.testing.assert_allclose(s, tau.states[t + 1], rtol=1e-6, atol=1e-7)
        assert reward == tau.rewards[t]
        assert terminated == (t == n - 1)
    assert tau.terminated
    assert n < world.H == 1000


def test_the_limit_of_a_wrapped_environment_is_found_and_can_be_shortened():
    limited = gym.wrappers.TimeLimit(gym.wrappers.OrderEnforcing(Corridor()), 13)
    assert GymWorld(limited).H == 13
    assert GymWorld(limited, horizon=5).H == 5
    assert GymWorld(limited, horizon=50).H == 13
    tau = GymWorld(limited).roll_out(uniform(2), key=jr.key(0))
    assert tau.length == 13
    assert not tau.terminated


def test_an_environment_without_a_limit_needs_a_horizon():
    with pytest.raises(InputError, match=r"got Corridor, which sets no limit .*; hiprl needs one\. .*--horizon 200"):
        GymWorld(Corridor())


def test_a_rule_that_is_given_is_used_and_unknown_environments_have_none():
    assert corridor().terminates is None
    assert corridor().ends
    past_four = GymWorld(Corridor(), horizon=11, terminates=lambda s, a, s_next: s_next[1] > 4.0)
    assert past_four.ends
    assert past_four.terminates(jnp.zeros(3), jnp.zeros(2), jnp.full(3, 5.0))
    assert not GymWorld(Corridor(), horizon=11, terminates=never).ends


@pytest.mark.parametrize(
    "rule",
    [
        lambda s, a, s_next: s_next > 4.0,
        lambda s, a, s_next: s_next[1],
        lambda s, a, s_next: bool(s_next[1] > 4.0),
        lambda s, a: s[1] > 4.0,
        lambda s, a, s_next: None,
    ],
    ids=["a value an entry", "a number", "not compiled", "two arguments", "nothing"],
)
def test_a_rule_that_gives_no_truth_value_is_refused(rule):
    with pytest.raises(InputError, match=r"got a rule of termination that .*Write it in jax.numpy"):
        GymWorld(Corridor(), horizon=11, terminates=rule)


def boom(_):
    raise ZeroDivisionError("the wheel came off")


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        (
            {"step": boom},
            r"broke at step 4 with ZeroDivisionError: the wheel came off\. .*must.*check_env",
        ),
        (
            {"step": lambda env: (env.buffer, 1.0, False, {})},
            r"gave .* at step 4; .*terminated, truncated.*Return",
        ),
        (
            {"step": lambda env: (np.full(3, np.nan), 1.0, False, False, {})},
            r"not finite at step 4 \(entries \[0, 1",
        ),
        (
            {"step": lambda env: (np.full(3, 1e200), 1.0, False, False, {})},
            r"not finite at step 4 .* smaller time",
        ),
        (
            {"step": lambda env: (np.zeros(2), 1.0, False, False, {})},
            r"shape \(2,\) at step 4; .*\(3,\)\. Make",
        ),
        (
            {"step": lambda env: (np.zeros((1, 3)), 1.0, False, False, {})},
            r"shape \(1, 3\) at step 4; it declares",
        ),
        (
            {"step": lambda env: ({"x": 1}, 1.0, False, False, {})},
            r"dict .*at step 4; it declares 3 numbers\. Make",
        ),
        (
            {"step": lambda env: (env.buffer, "good", False, False, {})},
            r"str 'good' as reward at step 4; .*Return",
        ),
        ({"step": lambda env: (env.buffer, np.inf, False, False, {})}, r"reward inf at step 4; .*Bound it"),
        (
            {"reset": lambda: np.zeros(3)},
            r"gave .*ndarray .* from reset; .*\(observation, info\)\. Return both",
        ),
        ({"reset": lambda: (np.array([1.0, np.inf, 0.0]), {})}, r"not finite at reset \(entries \[1\]\)"),
        ({"reset": lambda: boom(None)}, r"broke at reset.* with ZeroDivisionError"),
    ],
)
def test_what_breaks_in_an_episode_is_named_with_its_step(behaviour, message):
    world = corridor(**behaviour)
    with pytest.raises(WorldError, match=f"Corridor .*{message}") as caught:
        world.roll_out(uniform(2), key=jr.key(0))
    if "broke" in message:
        assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_a_world_can_be_used_again_after_its_environment_broke():
    world = corridor(step=boom)
    with pytest.raises(WorldError):
        world.roll_out(uniform(2), key=jr.key(0))
    del world.env.does["step"]
    assert world.roll_out(uniform(2), key=jr.key(0)).length == 11


def test_an_actor_that_diverged_is_not_blamed_on_the_environment():
    with pytest.raises(WorldError, match=r"the actor gave the action \[nan nan\] at step 0 .*diverged"):
        corridor().roll_out(Constant(jnp.full(2, jnp.nan)), key=jr.key(0))


def unusable(observation_space=Corridor.observation_space, action_space=Corridor.action_space):
    env = Corridor()
    env.observation_space, env.action_space = observation_space, action_space
    return env


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (
            spaces.Dict({"x": Corridor.observation_space}),
            r"kind Dict .*; hiprl needs one vector.*FlattenObservation",
        ),
        (spaces.Tuple((Corridor.observation_space,)), r"kind Tuple .*FlattenObservation"),
        (spaces.Discrete(5), r"kind Discrete .*FlattenObservation"),
        (spaces.Box(-1, 1, (3, 2)), r"kind Box \(shape \(3, 2\)\).*FlattenObservation"),
        (spaces.Box(-1, 1, ()), r"kind Box \(shape \(\)\).*FlattenObservation"),
        (
            spaces.Box(0, 255, (8, 8, 3), np.uint8),
            r"images .*\(8, 8, 3\)\); hiprl needs one vector.*TransformObservation",
        ),
        (spaces.Sequence(spaces.Discrete(3)), r"kind Sequence; .*TransformObservation"),
        (spaces.Box(-1, 1, (0,)), r"hold nothing; .*Make the environment observe"),
    ],
)
def test_observations_of_another_kind_are_refused_with_what_helps(space, message):
    with pytest.raises(InputError, match=f"got Corridor with .*{message}"):
        GymWorld(unusable(observation_space=space), horizon=11)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (spaces.Discrete(5), r"kind Discrete; hiprl needs real-valued.*MountainCarContinuous.*InvertedPendulum"),
        (spaces.MultiDiscrete([2, 3]), r"kind MultiDiscrete; .*continuous actions"),
        (spaces.MultiBinary(3), r"kind MultiBinary; .*continuous actions"),
        (spaces.Dict({"x": Corridor.action_space}), r"kind Dict; .*TransformAction"),
        (spaces.Box(-1, 1, (2, 2)), r"shape \(2, 2\) .*TransformAction"),
        (spaces.Box(-3, 3, (2,), np.int64), r"dtype int64; .*TransformAction"),
        (
            spaces.Box(-np.inf, np.inf, (2,)),
            r"finite bounds, and neither RescaleAction nor ClipAction.*\(2,\)",
        ),
        (
            spaces.Box(np.array([-1.0, 2.0]), np.array([1.0, 2.0]), dtype=np.float64),
            r"lower bound below .*Correct action_space",
        ),
    ],
)
def test_actions_of_another_kind_are_refused_with_what_helps(space, message):
    with pytest.raises(InputError, match=f"got Corridor with actions .*{message}"):
        GymWorld(unusable(action_space=space), horizon=11)


def test_what_the_refusals_advise_works():
    flat = gym.wrappers.FlattenObservation(unusable(observation_space=spaces.Box(-9, 99, (1, 3))))
    assert GymWorld(flat, horizon=3).p == 3
    endless = unusable(action_space=spaces.Box(-np.inf, np.inf, (2,)))
    bounded = gym.wrappers.TransformAction(endless, lambda a: a, gym.spaces.Box(-1, 1, (2,)))
    assert GymWorld(bounded, horizon=3).roll_out(uniform(2), key=jr.key(0)).length == 3


def test_observations_of_integers_and_other_floats_become_float32():
    tau = corridor().roll_out(uniform(2), key=jr.key(0))
    assert tau.states.dtype == tau.actions.dtype == jnp.float32
    env = Corridor(step=lambda env: (np.arange(3), 1.0, False, False, {}))
    assert GymWorld(env, horizon=11).roll_out(uniform(2), key=jr.key(0)).states[5, 2] == 2


def test_one_actor_compiles_once():
    from hiprl.world.gym import _act

    world = corridor()
    world.roll_out(uniform(2), key=jr.key(0))
    before = _act._cache_size()
    for seed in range(3):
        world.roll_out(uniform(2), key=jr.key(seed))
    assert _act._cache_size() == before


def test_closing_a_world_closes_its_environment():
    closed = []
    env = Corridor()
    env.close = lambda: closed.append(True)
    GymWorld(env, horizon=3).close()
    assert closed == [True]
