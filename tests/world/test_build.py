import sys

import gymnasium as gym
import jax.numpy as jnp
import jax.random as jr
import pytest

from hiprl.errors import InputError
from hiprl.world.build import world_from
from hiprl.world.gym import GymWorld
from hiprl.world.jax_world import JaxWorld
from hiprl.world.linear import default_linear
from hiprl.world.pendulum import SwingUp
from hiprl.world.termination import never
from tests.world.actors import uniform


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module into the working folder, which Python does not search by itself."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])

    def write(name, text):
        (tmp_path / f"{name}.py").write_text("import gymnasium as gym\n" + text)
        monkeypatch.delitem(sys.modules, name, raising=False)

    return write


def test_an_id_gives_its_environment_with_its_horizon_and_rule():
    world = world_from("Hopper-v5")
    assert (world.name, world.p, world.q, world.H) == ("Hopper-v5", 11, 3, 1000)
    assert world.ends
    assert world.terminates is not None
    assert world.spec() == "Hopper-v5"
    assert world_from("HalfCheetah-v5").terminates is never
    assert not world_from("HalfCheetah-v5").ends


@pytest.mark.parametrize("horizon", [37, 1500])
def test_the_horizon_of_an_id_can_be_shorter_or_longer_than_the_registered_one(horizon):
    world = world_from("HalfCheetah-v5", horizon=horizon)
    tau = world.roll_out(uniform(6), key=jr.key(0))
    assert world.H == horizon == tau.length
    assert not tau.terminated


def test_an_id_without_its_version_is_pinned_in_the_spec():
    assert world_from("Pendulum").spec() == "Pendulum-v1"


def test_names_of_our_own_take_settings():
    world = world_from("swing-up:action_cost=0.2", horizon=7)
    assert isinstance(world, JaxWorld)
    assert world.task.action_cost == jnp.float32(0.2)
    assert world.H == 7
    assert world.spec() == "swing-up:action_cost=0.2"
    assert world_from("swing-up").spec() == "swing-up"
    assert world_from("swing-up").H == 400
    assert world_from("linear:noise_std=0").task.noise_std == 0


@pytest.mark.parametrize("name", ["Pendulum-v1", "linear:noise_std=0.017", "swing-up:action_cost=1e-05", "swing-up"])
def test_a_spec_makes_the_same_world_again(name):
    world = world_from(name)
    again = world_from(world.spec())
    q = world.q
    one, same = (w.roll_out(uniform(q), key=jr.key(3)) for w in (world, again))
    assert (one.states == same.states).all()
    assert (one.rewards == same.rewards).all()


def test_a_function_of_the_users_own_module_is_found_in_the_working_folder(module):
    module(
        "mine",
        "def make():\n    return gym.make('Pendulum-v1')\nclass Inner:\n    make = staticmethod(make)\n",
    )
    world = world_from("mine:make", horizon=23)
    assert (world.spec(), world.name, world.H, world.terminates) == ("mine:make", "mine:make", 23, never)
    assert world_from("mine:Inner.make").p == 3


def test_a_function_may_give_a_task_and_a_module_may_be_called_like_one_of_our_names(module):
    module("linear", "from hiprl.world.pendulum import SwingUp\ndef task(): return SwingUp(0.1)\n")
    world = world_from("linear:task")
    assert world.name == "swing-up"
    assert world.spec() == "linear:task"
    assert world_from("linear").name == "linear"


def test_a_package_that_registers_ids_is_imported(module):
    module("registers", "gym.register(id='Mine-v3', entry_point='gymnasium.envs.classic_control:PendulumEnv')\n")
    world = world_from("registers:Mine-v3", horizon=5)
    assert world.spec() == "registers:Mine-v3"
    assert world.H == 5
    assert world.terminates is never


def test_objects_are_taken_and_have_no_spec():
    env = gym.make("Pendulum-v1")
    for given in (env, lambda: gym.make("Pendulum-v1"), SwingUp(), SwingUp, default_linear):
        world = world_from(given)
        assert world.spec() is None
        assert world.p == 3
    world = GymWorld(env)
    assert world_from(world) is world
    assert world_from(world, horizon=200) is world


def test_a_rule_of_termination_is_taken_as_function_or_by_name(module):
    module("rules", "def fast(s, a, s_next):\n    return s_next[2] > 7.0\n")
    for rule in ("rules:fast", lambda s, a, s_next: s_next[2] > 7.0):
        world = world_from("Pendulum-v1", terminates=rule)
        assert world.ends
        assert world.terminates(jnp.zeros(3), jnp.zeros(1), jnp.full(3, 8.0))
    assert not world_from("Hopper-v5", terminates=never).ends


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("HalfCheeta-v5", r"got 'HalfCheeta-v5', which is no .*; hiprl needs .*Did you mean HalfCheetah-v5"),
        ("halfcheetah-v5", r"Did you mean HalfCheetah-v5"),
        ("swingup", r"linear, swing-up\. Did you mean swing-up"),
        ("Hopper-v77", r"Did you mean Hopper-v"),
        ("nowhere/Thing-v0", r"no registered environment; .*package:id"),
        ("no_such_module:make", r"no module no_such_module; .*Check its name"),
        ("no_such_module:Mine-v0", r"no module no_such_module; .*Check its name"),
        ("os.path.nothing:make", r"no module os.path.nothing"),
        ("mine.py:make", r"no module mine.py; .*Leave out the ending: mine\."),
        ("math:sinn", r"math has no sinn; .*Did you mean sin or sinh"),
        ("math:pi", r"float that cannot be called; .*Define a function"),
        ("builtins:dict", r"got builtins.dict \{\} from 'builtins:dict'; hiprl needs .*Return one"),
        ("math:sin", r"calling it failed with TypeError: .*without arguments\. Give"),
        ("Hopper-v3", r"making it failed with ImportError.*Get that to work first"),
        ("Pendulum-v1/", r"got 'Pendulum-v1/'.*"),
        (
            "swing-up:actioncost=0.1",
            r"got 'actioncost=0.1' in swing-up:actioncost=0.1; .*Did you mean action_cost.*Write for example",
        ),
        ("swing-up:action_cost=much", r"got 'action_cost=much' .*each a number from 0"),
        ("swing-up:action_cost=-1", r"got 'action_cost=-1'"),
        ("swing-up:action_cost=nan", r"got 'action_cost=nan'"),
        ("CartPole-v1", r"CartPole-v1 with actions of kind Discrete"),
        ("", r"got ''"),
    ],
)
def test_a_name_that_leads_nowhere_is_refused_with_what_helps(name, message):
    with pytest.raises(InputError, match=message):
        world_from(name)


def test_a_module_that_breaks_on_import_is_told_from_one_that_is_missing(module):
    module("needy", "import not_installed_anywhere\n")
    with pytest.raises(InputError, match=r"importing needy failed with ModuleNotFoundError: .*not_installed_anywhere"):
        world_from("needy:make")
    module("broken", "1 / 0\n")
    with pytest.raises(InputError, match=r"importing broken failed with ZeroDivisionError.*python -c"):
        world_from("broken:make")


def test_a_missing_dependency_is_named(monkeypatch):
    def needs_more():
        raise gym.error.DependencyNotInstalled("box2D is not installed, run `pip install ...`")

    monkeypatch.setitem(gym.registry, "Needy-v0", gym.envs.registration.EnvSpec("Needy-v0", needs_more))
    with pytest.raises(InputError, match=r"'Needy-v0', which needs a package .*box2D.*Install"):
        world_from("Needy-v0")


@pytest.mark.parametrize("given", [3.5, {}, [1, 2], lambda: "Pendulum-v1"])
def test_what_is_no_environment_is_refused(given):
    with pytest.raises(InputError, match=r"got .*; hiprl needs a gymnasium.Env, a Task or a World\. Return"):
        world_from(given)


@pytest.mark.parametrize("horizon", [0, -3])
def test_a_horizon_without_a_step_is_refused(horizon):
    with pytest.raises(InputError, match=r"got horizon=.*; an episode needs .*--horizon 200"):
        world_from("Pendulum-v1", horizon=horizon)


def test_a_rule_that_is_no_function_is_refused():
    with pytest.raises(InputError, match=r"got builtins.float 0.5 as the rule .*; it must be a function .*Pass"):
        world_from("Pendulum-v1", terminates=0.5)


def test_a_world_keeps_its_own_horizon_and_rule():
    world = world_from("Pendulum-v1")
    for change in ({"horizon": 3}, {"terminates": never}):
        with pytest.raises(InputError, match=r"got the world Pendulum-v1 with .*; a world has its own\. Give"):
            world_from(world, **change)
    with pytest.raises(InputError, match=r"got the task linear with a rule"):
        world_from("linear", terminates=never)
