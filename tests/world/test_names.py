from types import SimpleNamespace

import gymnasium as gym
import mujoco
import pytest

from hiprl.world.build import world_from
from hiprl.world.names import names_of, numbered


def named(env_id):
    world = world_from(env_id)
    names = world.names()
    assert len(names.state) == world.p and len(names.action) == world.q
    world.close()
    return names


def test_a_runner_is_named_by_its_joints_from_the_first_that_is_observed():
    names = named("HalfCheetah-v5")
    assert names.state[:3] == ("rootz position", "rooty angle", "bthigh angle")
    assert names.state[8:10] == ("rootx velocity", "rootz velocity") and names.state[-1] == "ffoot spin"
    assert names.action[0] == "bthigh effort"


def test_a_free_body_has_a_place_a_turn_and_their_rates():
    names = named("Ant-v5")
    assert names.state[:6] == ("root z", "root qw", "root qx", "root qy", "root qz", "hip_1 angle")
    assert names.state[13:19] == (
        "root velocity x",
        "root velocity y",
        "root velocity z",
        "root spin x",
        "root spin y",
        "root spin z",
    )
    assert names.state[27] == "s[27]"  # forces from outside have no names of their own
    assert names.action[0] == "hip_4 effort"  # an actuator without a name has that of its joint


@pytest.mark.parametrize("env_id", ["Pendulum-v1", "linear"])
def test_without_a_model_there_are_numbers(env_id):
    names = named(env_id)
    assert names.state[0] == "s[0]" and names.action[0] == "a[0]"


def test_an_observation_of_another_kind_has_numbers():
    env = gym.make("Reacher-v5")  # cosines and sines of its joints
    assert names_of(env, 10, 2).state == numbered(10, 2).state
    assert names_of(env, 10, 2).action == ("joint0 effort", "joint1 effort")
    assert names_of(env, 8, 3).action == numbered(8, 3).action
    assert names_of(env, 8, 2).state[4] == "joint0 spin"  # all positions and all velocities
    env.close()


TWO = """<mujoco><worldbody><body name="b"><joint name="hip" type="hinge"/><geom size=".1"/></body></worldbody>
<tendon><fixed name="t"><joint joint="hip" coef="1"/></fixed></tendon>
<actuator><motor joint="hip"/><motor joint="hip"/><motor tendon="t"/></actuator></mujoco>"""


def test_only_what_moves_a_joint_is_named_by_it():
    model = mujoco.MjModel.from_xml_string(TWO)
    assert names_of(SimpleNamespace(unwrapped=SimpleNamespace(model=model)), 2, 3).action == (
        *("hip effort", "hip effort", "a[2]"),
    )
