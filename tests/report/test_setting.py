from __future__ import annotations

from dataclasses import replace

import pytest

from hiprl.config import Config, preset
from hiprl.control.plan import PlanConfig
from hiprl.control.ppo import PPOConfig
from hiprl.report.setting import setting
from hiprl.store.store import Store
from tests.report.made_up import add_run

ENV = "HalfCheetah-v5"


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (Config(), "default"),
        (Config(comparisons=7), "default"),
        (Config(comparisons=3, warm_up=3), "default"),
        (Config(comparisons=17, warm_up=3), "default, warm_up 3"),
        (Config(optimism="greedy"), "default, optimism greedy"),
        (Config(plan=PlanConfig(kind="mpc")), "default, plan mpc"),
        (Config(plan=PlanConfig(kind="mpc", horizon=5)), "default, plan mpc, plan.horizon 5"),
        (Config(search=PPOConfig()), "default, search ppo"),
        (preset("paper", ENV), "paper"),
        (replace(preset("paper", ENV), kappa=0.3), "paper, kappa 0.3"),
    ],
)
def test_settings_are_told_by_the_nearest_preset(store: Store, config: Config, words: str) -> None:
    row = store.run(add_run(store, env=ENV, config=config, episodes=0, finished=False))
    assert setting(row).words() == words


def test_another_judge_is_told(store: Store) -> None:
    row = store.run(add_run(store, judge="noisy:50", episodes=0, finished=False))
    assert setting(row).words() == "default, judge noisy:50"


def test_many_changes_are_counted(store: Store) -> None:
    config = Config(optimism="greedy", kappa=0.5, bonus=2.0, restart=False)
    row = store.run(add_run(store, config=config, episodes=0, finished=False))
    assert setting(row).words(most=3) == "default, optimism greedy, kappa 0.5, bonus 2, and 1 more"
    assert setting(row).words() == "default, optimism greedy, kappa 0.5, bonus 2, restart False"
