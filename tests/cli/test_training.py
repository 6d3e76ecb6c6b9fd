from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hiprl.cli import training
from hiprl.cli.commands import Resume, Train
from hiprl.cli.main import main
from hiprl.cli.resuming import resume
from hiprl.cli.training import config_of, outcome, train
from hiprl.config import Config, paper
from hiprl.control.gradient import GradientConfig
from hiprl.errors import StoreError
from hiprl.session import spec_of
from hiprl.store.store import open_store
from tests.cli.tiny import TINY

KEYS = ["run", "env", "seed", "comparisons", "env_steps", "return_mean", "return_std", "eval_episodes", "trajectory"]
KEYS += ["wall_seconds", "store"]


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """Settings that learn nothing, quickly."""
    monkeypatch.setattr(training, "preset", lambda name, env: TINY)


def words(store: Path, *more: str) -> list[str]:
    return ["train", "linear", "--horizon", "7", "--eval-episodes", "3", "--store", str(store), *more]


def test_flags_change_the_preset() -> None:
    assert config_of(Train(env="x"), "Hopper-v5") == Config()
    assert config_of(Train(env="x", preset="paper"), "Hopper-v5") == paper("Hopper-v5")
    changed = config_of(Train(env="x", optimism="bonus", plan="mpc", search="ppo", comparisons=17), "HalfCheetah-v5")
    assert (changed.optimism, changed.plan.kind, changed.comparisons) == ("bonus", "mpc", 17)
    assert changed.search == paper("HalfCheetah-v5").search
    gradient = config_of(Train(env="x", preset="paper", search="gradient"), "Hopper-v5")
    assert gradient.search == GradientConfig()
    assert gradient.reward == paper("Hopper-v5").reward


def test_a_flag_that_names_the_presets_own_search_keeps_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "preset", lambda name, env: TINY)
    assert config_of(Train(env="x", search="gradient"), "Hopper-v5").search == TINY.search


def test_few_comparisons_shorten_the_warm_up() -> None:
    assert config_of(Train(env="x", comparisons=3), "Hopper-v5").warm_up == 3


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_train_stores_a_run_and_tells_what_came_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = tmp_path / "new" / "folder" / "runs.db"
    command = words(store, "--comparisons", "4", "--seed", "11", "--json", "--tensorboard", str(tmp_path / "events"))
    assert main(command) == 0
    shown = capsys.readouterr()
    facts = json.loads(shown.out)
    assert [*facts] == KEYS
    assert (facts["env"], facts["seed"], facts["comparisons"], facts["eval_episodes"]) == ("linear", 11, 4, 3)
    assert facts["env_steps"] == (5 + Config().confirmations) * 7
    assert facts["store"] == str(store)
    lines = shown.err.splitlines()
    assert lines[0].startswith(f"Run {facts['run']}: linear, judge exact, 4 comparisons, seed 11; stored in {store}.")
    assert [line.split(",")[0] for line in lines[1:5]] == [f"episode {k}/4" for k in range(1, 5)]
    assert lines[-2] == outcome(facts)
    assert lines[-1] == f"Next: hiprl show {facts['run']} --store {store}"
    assert len(list((tmp_path / "events" / facts["run"]).iterdir())) == 1
    with open_store(store) as opened:
        assert opened.final(facts["run"]) == facts
        assert spec_of(opened, facts["run"]).judge == "exact"


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_a_run_that_fails_says_how_to_go_on_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store, events = tmp_path / "runs.db", tmp_path / "events"
    whole = train(Train(env="linear", horizon=7, comparisons=4, eval_episodes=3, store=str(tmp_path / "whole.db")))
    capsys.readouterr()
    real = training.progress

    def failing(*arguments):
        display = real(*arguments)

        class Fails(type(display)):
            def __call__(self, facts: dict) -> None:
                super().__call__(facts)
                if facts["k"] == 3:
                    raise StoreError("the disk is full")

        display.__class__ = Fails
        return display

    with monkeypatch.context() as patch:
        patch.setattr(training, "progress", failing)
        assert main(words(store, "--comparisons", "4", "--tensorboard", str(events))) == 1
    shown = capsys.readouterr().err
    run_id = re.findall(r"^Run (\S+):", shown)[0]
    assert f"error: the disk is full\nWhat is finished is stored. Go on with: hiprl resume {run_id} --store" in shown
    facts = resume(Resume(run=run_id, store=str(store), tensorboard=str(events)))
    shown = capsys.readouterr().err
    assert "It goes on after episode 3." in shown
    assert "episode 3/4" not in shown
    assert "episode 4/4" in shown
    same = {"return_mean", "return_std", "env_steps", "comparisons", "eval_episodes"}
    assert {name: facts[name] for name in same} == {name: whole[name] for name in same}
    assert len(list((events / run_id).iterdir())) == 2


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_a_rule_of_termination_is_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my_rule_and_env.py").write_text(
        "import gymnasium\n"
        "def rule(s, a, s_next):\n    return abs(s_next[0]) > 100\n"
        "def make():\n    return gymnasium.make('Pendulum-v1', max_episode_steps=7)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    store = str(tmp_path / "runs.db")
    rule = ["--terminates", "my_rule_and_env:rule"]
    command = ["train", "my_rule_and_env:make", "--eval-episodes", "2", "--comparisons", "2", "--store", store, *rule]
    monkeypatch.setattr(training, "carry_on", lambda *_, **__: 1 / 0)
    assert main(command) == 1
    monkeypatch.undo()
    monkeypatch.syspath_prepend(str(tmp_path))
    with open_store(store) as opened:
        (row,) = opened.runs()
        assert row.spec["terminates"] == "my_rule_and_env:rule"
        assert spec_of(opened, row.id).terminates == "my_rule_and_env:rule"
    capsys.readouterr()
    assert main(["resume", row.id, "--store", store, "--json"]) == 0
    assert [*json.loads(capsys.readouterr().out)] == KEYS


@pytest.mark.slow
def test_ctrl_c_stops_and_resume_finishes(tmp_path: Path) -> None:
    hiprl = [sys.executable, "-m", "tests.cli.tiny"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    command = [*hiprl, *words(tmp_path / "runs.db", "--comparisons", "3", "--json")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stderr is not None
        assert process.stdout is not None
        first = process.stderr.readline()
        for line in process.stderr:
            if line.startswith("episode 2/3"):  # what follows is a search
                process.send_signal(signal.SIGINT)
                break
        said = process.stderr.read()
        assert process.stdout.read() == ""
        assert process.wait() == 130
    run_id = re.findall(r"^Run (\S+):", first)[0]
    again = f"hiprl resume {run_id} --store {tmp_path / 'runs.db'} --json"
    assert f"Stopped; what is finished is stored. Go on with: {again}" in said
    assert "Traceback" not in said
    resumed = subprocess.run([*hiprl, *again.split()[1:]], capture_output=True, text=True, env=environment, check=True)
    facts = json.loads(resumed.stdout.splitlines()[-1])
    assert (facts["run"], facts["comparisons"]) == (run_id, 3)
    assert "It goes on after episode 2." in resumed.stderr


def test_the_outcome_in_words() -> None:
    facts = dict.fromkeys(KEYS) | {"env": "Hopper-v5", "comparisons": 12, "wall_seconds": 130.4, "eval_episodes": 10}
    assert outcome(facts) == (
        "Hopper-v5 learned from 12 comparisons in 2 min 10 s. The environment pays no reward, so no return is known."
    )
    facts |= {"return_mean": 1000.0, "return_std": 0.0}
    assert outcome(facts).endswith("Return 1000.0 ± 0.0 over 10 episodes.")
