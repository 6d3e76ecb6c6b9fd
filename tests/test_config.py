import pytest

from hiprl.config import PRESETS, Config, asking, paper, preset
from hiprl.control.gradient import GradientConfig
from hiprl.control.plan import PlanConfig
from hiprl.control.ppo import PPOConfig
from hiprl.errors import InputError
from hiprl.feedback.judges import judge_from
from hiprl.models.dynamics import DynamicsConfig
from hiprl.models.reward import AdditiveConfig
from hiprl.models.reward_network import NetworkConfig
from hiprl.session import RunSpec


def message_of(**settings):
    with pytest.raises(InputError) as caught:
        Config(**settings)
    return str(caught.value)


@pytest.mark.parametrize("comparisons", [1, 0, -3])
def test_too_few_comparisons_are_refused_in_three_parts(comparisons):
    message = message_of(comparisons=comparisons)
    assert f"got {comparisons} comparisons" in message and "at least 2" in message and "--comparisons 30" in message


@pytest.mark.parametrize("warm_up", [1, 0, 8])
def test_a_warm_up_that_does_not_fit_is_refused_in_three_parts(warm_up):
    message = message_of(comparisons=7, warm_up=warm_up)
    assert f"warm-up of {warm_up}" in message and "at least 2 trajectories" in message and "Change one" in message


def test_the_warm_up_may_fill_the_run_but_for_one_search():
    assert Config(comparisons=2, warm_up=2).warm_up == 2


def test_widths_below_nothing_are_refused_in_three_parts():
    for settings in ({"kappa": -0.1}, {"kappa_decay": 0.0}, {"bonus": -1.0}, {"kappa": float("nan")}):
        message = message_of(**settings)
        assert "got kappa" in message and "0 or more" in message and "Use 0" in message


@pytest.mark.parametrize(
    ("judge", "clip", "pick", "practice"),
    [
        ("exact", None, "uniform", 0),
        ("noisy:3", None, "uniform", 0),
        (lambda tau, other: 0.0, None, "uniform", 0),
        ("choice", 50, "information", 1),
        ("graded", 50, "information", 1),
    ],
)
def test_judges_are_asked_what_they_can_tell_and_practice_follows_what_tells_little(judge, clip, pick, practice):
    asked = asking(Config(), judge_from(judge))
    assert (asked.question.clip, asked.question.pick, asked.practice) == (clip, pick, practice)
    assert asking(Config(practice=3), judge_from(judge)).practice == 3
    told = asking(Config(), judge_from(judge), clip=0, pick="uniform", practice=0)
    assert (told.question.clip, told.question.pick, told.practice) == (None, "uniform", 0)


def test_searches_and_trajectories_are_counted():
    config = Config(comparisons=7, warm_up=3, practice=1)
    assert [config.searches_after(k) for k in range(6)] == [0, 0, 0, 2, 4, 6]
    assert [config.executed_after(k) for k in range(6)] == [1, 2, 3, 5, 7, 9]
    assert config.trajectories == config.executed_after(7) == 13
    imagining = asking(config, judge_from("exact"), imagined=True)
    assert imagining.question.imagined and imagining.trajectories == 13 + 10


def test_only_the_policy_that_chooses_eta_has_outputs_for_it():
    assert Config(optimism="eta_policy").eta_size(7) == 7
    assert Config(optimism="thompson").eta_size(7) == 0


def test_the_default_learns_the_additive_reward_by_gradients():
    config = preset("default", "HalfCheetah-v5")
    assert config == Config()
    assert isinstance(config.reward, AdditiveConfig) and isinstance(config.search, GradientConfig)
    assert config.comparisons == 30 and config.warm_up == 5


@pytest.mark.parametrize("env", ["HalfCheetah-v5", "InvertedPendulum-v5"])
def test_the_paper_preset_is_appendix_b(env):
    config = preset("paper", env)
    assert config == paper(env)
    assert config.optimism == "eta_policy" and config.plan.kind == "sample"
    assert config.dynamics.M == 5 and config.dynamics.hidden == (32, 32) and config.dynamics.activation == "relu"
    assert config.dynamics.learning_rate == 1e-3 and config.dynamics.weight_decay == 0
    assert not config.dynamics.bootstrap and not config.dynamics.quieten
    assert isinstance(config.reward, NetworkConfig)
    assert config.reward.hidden == (32, 32) and config.reward.activation == "relu"
    assert config.reward.learning_rate == 1e-2


def test_ppo_has_the_settings_of_tables_2_and_3():
    table_2 = {
        "learning_rate": 0.00025,
        "n_steps": 500,
        "batch_size": 256,
        "n_epochs": 5,
        "gamma": 0.999,
        "gae_lambda": 0.9,
        "clip_range": 0.4,
        "ent_coef": 1.5e-7,
        "vf_coef": 0.2,
        "max_grad_norm": 0.3,
        "total_timesteps": 100_000,
    }
    table_3 = {
        "learning_rate": 1.0633e-05,
        "n_steps": 512,
        "batch_size": 64,
        "n_epochs": 20,
        "gamma": 0.98,
        "gae_lambda": 0.92,
        "clip_range": 0.1,
        "ent_coef": 0.000401762,
        "vf_coef": 0.58096,
        "max_grad_norm": 0.8,
        "total_timesteps": 100_000,
    }
    for env, table in (("InvertedPendulum-v5", table_2), ("HalfCheetah-v5", table_3), ("Hopper-v5", table_2)):
        search = paper(env).search
        assert isinstance(search, PPOConfig)
        assert {name: getattr(search, name) for name in table} == table


def test_an_unknown_preset_is_refused_in_three_parts():
    with pytest.raises(InputError) as caught:
        preset("papre", "Hopper-v5")
    message = str(caught.value)
    assert "'papre'" in message and all(name in message for name in PRESETS) and "--preset" in message


WITHOUT_A_MEANING = {
    "one member": lambda: DynamicsConfig(M=1),
    "one reward network": lambda: NetworkConfig(members=1),
    "more elites than proposals": lambda: PlanConfig(elites=65),
    "noise as large as the box": lambda: PlanConfig(noise=1.0),
    "a seed that is too large": lambda: RunSpec(seed=1 << 32, config=Config(), judge="exact"),
    "a negative seed": lambda: RunSpec(seed=-1, config=Config(), judge="exact"),
}


@pytest.mark.parametrize("wrong", WITHOUT_A_MEANING)
def test_a_setting_without_a_meaning_is_refused_in_three_parts(wrong):
    with pytest.raises(InputError, match=r"got .*; .*\. (Take|Change|Choose) "):
        WITHOUT_A_MEANING[wrong]()
