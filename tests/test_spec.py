import json
from dataclasses import replace

import pytest

from hiprl.config import Config, paper
from hiprl.control.gradient import GradientConfig
from hiprl.control.plan import PlanConfig
from hiprl.errors import StoreError
from hiprl.models.dynamics import DynamicsConfig
from hiprl.models.reward import AdditiveConfig
from hiprl.spec import from_plain, to_plain, versions

CONFIGS = {
    "default": Config(),
    "paper": paper("HalfCheetah-v5"),
    "changed": Config(
        comparisons=17,
        warm_up=3,
        optimism="bonus",
        kappa=0.3,
        restart=False,
        dynamics=DynamicsConfig(M=7, hidden=(11, 13), bootstrap=False),
        reward=AdditiveConfig(noise=(1e-3,)),
        search=GradientConfig(hidden=(5,), gamma=0.97),
        plan=PlanConfig(kind="mpc", horizon=3),
    ),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_a_config_comes_back_from_what_a_row_can_keep(name):
    config = CONFIGS[name]
    again = from_plain(json.loads(json.dumps(to_plain(config))))
    assert again == config
    assert hash(again) == hash(config)  # lists would have none, and jit needs one


def test_plain_values_tell_configs_apart():
    assert to_plain(replace(Config(), kappa=0.5)) != to_plain(Config())


def test_versions_name_all_that_a_draw_depends_on():
    known = versions()
    assert {"hiprl", "python", "jax", "jaxlib", "numpy", "mujoco"} <= set(known)
    assert json.loads(json.dumps(known)) == known


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda plain: plain | {"part": "NewConfig"}, "NewConfig is unknown"),
        (lambda plain: plain | {"new_setting": 3}, "new_setting is unknown"),
        (lambda plain: plain | {"plan": plain["plan"] | {"depth": 3}}, "depth is unknown"),
        (lambda plain: plain | {"search": plain["search"] | {"rollouts": None}}, "rollouts has no value"),
    ],
)
def test_settings_of_another_version_are_named(change, named):
    with pytest.raises(StoreError, match=rf"another version of hiprl: {named}\. Go on with the version that made"):
        from_plain(change(to_plain(Config())))
