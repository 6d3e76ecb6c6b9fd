import base64
import io
from typing import ClassVar

import gymnasium as gym
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from PIL import Image

from hiprl.control.policy import Uniform
from hiprl.data.film import Film
from hiprl.errors import InputError
from hiprl.world.build import world_from
from hiprl.world.camera import FITS, Pictures


def test_a_mujoco_world_is_filmed_by_where_its_bodies_are():
    world = world_from("HalfCheetah-v5", horizon=20)
    assert world.film is None
    scene = world.start_filming()
    model = world.env.unwrapped.model
    assert scene["kind"] == "mujoco" and scene["bodies"] == model.nbody and scene["dt"] == pytest.approx(0.05)
    assert {geom["type"] for geom in scene["geoms"]} == {"plane", "capsule"}
    tau = world.roll_out(Uniform(jnp.ones(()), world.q), key=jr.key(1))
    poses = world.film.poses
    assert poses.shape == (21, model.nbody, 7)
    np.testing.assert_allclose(np.linalg.norm(poses[..., 3:], axis=-1), 1, atol=1e-5)
    torso = 1
    np.testing.assert_allclose(
        poses[:, torso, 2] - poses[0, torso, 2], tau.states[:21, 0] - tau.states[0, 0], atol=1e-4
    )
    speed = np.diff(poses[:, torso, 0]) / scene["dt"]
    np.testing.assert_allclose(speed, np.asarray(tau.states[1:21, 8]), atol=1.5)  # over a step, and at its end
    world.close()


def test_what_is_imagined_is_drawn_from_its_observations():
    world = world_from("HalfCheetah-v5", horizon=20)
    assert not world.films_imagined and world.film_of(np.zeros((3, 17))) is None  # it does not film yet
    scene = world.start_filming()
    assert world.films_imagined
    tau = world.roll_out(Uniform(jnp.ones(()), world.q), key=jr.key(1))
    seen, drawn = world.film.poses, world.film_of(np.asarray(tau.states)).poses
    np.testing.assert_allclose(drawn[..., 1:3], seen[..., 1:3], atol=1e-5)
    np.testing.assert_allclose(drawn[..., 3:], seen[..., 3:], atol=1e-5)
    along = drawn[:, 1, 0]  # where it is along x is not observed: from its speed, and from where it was
    np.testing.assert_allclose(np.diff(along), scene["dt"] * np.asarray(tau.states[:20, 8]), atol=1e-5)
    to_torso = lambda poses: poses[:, 2:, 0] - poses[:, 1, 0, None]
    np.testing.assert_allclose(to_torso(drawn), to_torso(seen), atol=1e-5)
    world.close()


@pytest.mark.parametrize("env", ["InvertedDoublePendulum-v5", "Reacher-v5"])  # observes sines; leaves joints out
def test_bodies_that_are_not_observed_are_not_drawn_from_observations(env):
    world = world_from(env)
    world.start_filming()
    assert not world.films_imagined and world.film_of(np.zeros((3, world.p))) is None
    world.close()


class Mirrored(gym.ObservationWrapper):
    """Observes all joints with the sign turned round."""

    def observation(self, observation):
        return -observation


def test_observations_that_were_changed_on_the_way_are_not_drawn_from():
    world = world_from(Mirrored(gym.make("Hopper-v5")))
    world.start_filming()
    assert not world.films_imagined and world.film_of(np.zeros((3, world.p))) is None
    world.close()


def test_each_episode_has_a_film_of_its_own():
    world = world_from("InvertedPendulum-v5")
    world.start_filming()
    lengths = []
    for seed in range(3):
        tau = world.roll_out(Uniform(jnp.ones(()), world.q), key=jr.key(seed))
        assert len(world.film.poses) == int(tau.length) + 1
        lengths.append(int(tau.length))
    assert len(set(lengths)) > 1
    world.close()


def test_meshes_and_hidden_shapes():
    mujoco = pytest.importorskip("mujoco")
    from hiprl.world.camera import Bodies

    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <asset>
            <mesh name="tip" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>
            <material name="red" rgba="1 0 0 1"/>
          </asset>
          <worldbody>
            <body name="a" pos="0 0 1">
              <freejoint/>
              <geom type="mesh" mesh="tip" material="red"/>
              <geom type="box" size=".1 .2 .3" rgba="0 0 0 0"/>
              <geom type="sphere" size=".1" group="3"/>
            </body>
          </worldbody>
        </mujoco>""")
    (geom,) = (scene := Bodies(model, mujoco.MjData(model), 0.1).scene)["geoms"]
    assert (geom["type"], geom["mesh"], geom["rgba"]) == ("mesh", 0, [1, 0, 0, 1])
    (mesh,) = scene["meshes"]
    vertices = np.frombuffer(base64.b64decode(mesh["vertices"]), np.float32).reshape(-1, 3)
    faces = np.frombuffer(base64.b64decode(mesh["faces"]), np.uint32).reshape(-1, 3)
    assert vertices.shape == (4, 3) and faces.max() == 3


class Painted(gym.Env):
    """Counts its steps, and paints how many there were."""

    observation_space = spaces.Box(-1, 1, (2,), np.float32)
    action_space = spaces.Box(-1, 1, (1,), np.float32)
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012
    render_mode = "rgb_array"

    def reset(self, *, seed=None, options=None):
        self.t = 0
        return np.zeros(2, np.float32), {}

    def step(self, action):
        self.t += 1
        return np.zeros(2, np.float32), 0.0, False, False, {}

    def render(self):
        return np.full((300, 480, 3), 20 * self.t, np.uint8)


def test_another_environment_is_filmed_by_its_own_pictures():
    world = world_from(Painted(), horizon=5)
    assert world.start_filming() == {"kind": "frames", "dt": 0.1}
    world.roll_out(Uniform(jnp.ones(()), 1), key=jr.key(0))
    pictures = [Image.open(io.BytesIO(one)) for one in world.film.pictures]
    assert [one.size for one in pictures] == [(240, 150)] * 6
    assert [round(float(np.asarray(one).mean()) / 20) for one in pictures] == list(range(6))


class PaintsIfAsked(Painted):
    """Draws itself only where it was made for that, as Gymnasium's own do."""

    metadata: ClassVar = {"render_fps": 10, "render_modes": ["rgb_array"]}

    def __init__(self, render_mode=None, broken=False):
        self.render_mode, self.broken = render_mode, broken

    def render(self):
        if self.broken:
            raise ImportError("no module to draw with")
        return super().render()


@pytest.fixture
def registered():
    names = {"tests/Paints-v0": {}, "tests/Broken-v0": {"broken": True}}
    for name, settings in names.items():
        gym.register(name, PaintsIfAsked, kwargs=settings, max_episode_steps=9)
    yield
    for name in names:
        del gym.registry[name]


def test_a_registered_environment_is_made_to_draw_itself(registered):
    world = world_from("tests/Paints-v0", horizon=5)
    assert world.start_filming() == {"kind": "frames", "dt": 0.1} and world.H == 5
    tau = world.roll_out(Uniform(jnp.ones(()), 1), key=jr.key(0))
    assert len(world.film.pictures) == int(tau.length) + 1 == 6
    assert world.start_filming(drawn=True) is not None
    world.roll_out(Uniform(jnp.ones(()), 1), key=jr.key(0))
    assert Image.open(io.BytesIO(world.film.pictures[0])).size == (480, 300)


def test_one_that_cannot_draw_shows_its_states(registered):
    world = world_from("tests/Broken-v0", horizon=5)
    assert world.start_filming() is None
    assert int(world.roll_out(Uniform(jnp.ones(()), 1), key=jr.key(0)).length) == 5


def test_a_picture_is_small_enough_to_be_sent_a_hundred_times():
    noise = np.random.default_rng(0).integers(0, 256, (300, 480, 3))
    assert len(Pictures(lambda: np.full((300, 480, 3), 9), 0.1).look()) < FITS
    rough = Image.open(io.BytesIO(Pictures(lambda: noise, 0.1).look()))
    assert rough.size == (160, 100)  # what fits least of all is sent as small as can be


def test_where_bodies_cannot_be_drawn_that_is_said(monkeypatch):
    def fails(self, mode):
        raise RuntimeError("no OpenGL")

    monkeypatch.setattr(MujocoRenderer, "render", fails)
    world = world_from("InvertedPendulum-v5", horizon=5)
    with pytest.raises(InputError, match=r"no OpenGL.*drawn with OpenGL.*MUJOCO_GL=egl"):
        world.start_filming(drawn=True)
    assert world.start_filming()["kind"] == "mujoco"  # a page needs none


def test_of_some_worlds_nothing_is_to_be_seen():
    world = world_from("linear", horizon=5)
    assert world.start_filming() is None
    world.roll_out(Uniform(jnp.ones(()), world.q), key=jr.key(0))
    assert world.film is None


def test_films_come_back_as_they_were_kept():
    poses = np.random.default_rng(0).normal(size=(9, 2, 7)).astype(np.float32)
    again = Film.from_bytes(Film(poses=poses).to_bytes())
    np.testing.assert_array_equal(again.poses, poses)
    np.testing.assert_array_equal(again.cut(2, 3).poses, poses[2:6])
    np.testing.assert_array_equal(again.cut(2, None).poses, poses[2:])
    pictures = [b"one", b"", b"three"]
    again = Film.from_bytes(Film(pictures=pictures).to_bytes())
    assert list(again.pictures) == pictures and list(again.cut(1, 1).pictures) == pictures[1:]
