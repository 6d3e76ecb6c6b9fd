from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import hiprl
from tests.whole.tasks import TINY, Sledge

# as tiny, but with steps large enough to get somewhere
EAGER = replace(TINY, search=replace(TINY.search, updates=300, rollouts=8, policy_rate=1e-2, value_rate=1e-2))


def to_the_right(tau, other):
    return float(tau.states[:, 0].sum() - other.states[:, 0].sum())


def learned(judge, store):
    env = gym.wrappers.TimeLimit(Sledge(), 31)
    return hiprl.learn(env, judge, config=EAGER, seed=5, store=store / "runs.db")


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    return learned(to_the_right, tmp_path_factory.mktemp("right"))


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    return learned(lambda tau, other: -to_the_right(tau, other), tmp_path_factory.mktemp("wrong"))


def end_of(learned):
    """The first number of the state after an episode of the learned behaviour."""
    env = gym.wrappers.TimeLimit(Sledge(), 31)
    obs, _ = env.reset(seed=1)
    over = False
    while not over:
        action, _ = learned.predict(obs)
        assert env.action_space.contains(action)
        obs, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    return float(obs[0])


@pytest.mark.slow
def test_a_judge_of_ones_own_teaches_an_environment_without_a_reward(right):
    assert end_of(right) > 0.75  # at full push it would be 1.5
    assert right.summary["return_mean"] is None  # nobody paid anything, so none is made up
    assert right.summary["comparisons"] == EAGER.comparisons


@pytest.mark.slow
def test_a_judge_who_wants_the_opposite_gets_the_opposite(right, wrong):
    assert end_of(wrong) < -0.75 < end_of(right)


@pytest.mark.slow
def test_what_was_learned_can_be_loaded_again(right, tmp_path_factory):
    env = gym.wrappers.TimeLimit(Sledge(), 31)
    again = hiprl.load(right.summary["run"], env=env, store=right.summary["store"])
    obs = np.array([0.3, -0.2, 0.1], np.float32)
    np.testing.assert_array_equal(again.predict(obs)[0], right.predict(obs)[0])
    assert again.summary == right.summary
