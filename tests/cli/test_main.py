from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest

from hiprl.cli import commands, serving
from hiprl.cli.main import DONE, FAILED, WRONG_INPUT, main, read, run
from hiprl.config import PRESETS, preset
from hiprl.control.plan import PLANS
from hiprl.errors import InputError, StoreError
from hiprl.hallucinated import OPTIMISM
from hiprl.report.figures import PICTURES
from hiprl.store.store import open_store
from tests.report.made_up import add_run

COMMANDS = {
    "train": commands.Train,
    "resume": commands.Resume,
    "show": commands.Show,
    "compare": commands.Compare,
    "relearn": commands.Relearn,
}
DOCS = Path(__file__).resolve().parents[2] / "docs" / "commands.md"


def flags(command: type) -> list[str]:
    positional = {"env", "run", "runs"}
    names = [field.name for field in dataclasses.fields(command) if field.name not in positional]
    return ["--" + name.replace("_", "-") for name in names]


def fails(error: BaseException) -> Callable[[], dict]:
    def command() -> dict:
        raise error

    return command


@pytest.mark.parametrize("name", COMMANDS)
def test_help_explains_each_flag_with_its_default(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == DONE
    shown = capsys.readouterr().out
    for flag in flags(COMMANDS[name]):
        assert flag in shown
    options = shown.split("options ─", 2)[-1]
    assert options.count("(default") >= len(flags(COMMANDS[name]))
    assert "None" not in shown


@pytest.mark.parametrize("name", COMMANDS)
def test_the_documentation_has_each_flag_in_its_section(name: str) -> None:
    section = DOCS.read_text().split(f"\n## {name}\n")[1].split("\n## ")[0]
    for flag in flags(COMMANDS[name]):
        assert f"`{flag}" in section, flag


def test_help_loads_nothing_that_takes_long() -> None:
    code = (
        "import sys; from hiprl.cli.main import main; main(['--help']); main(['train', '--help']); "
        "print(*(m for m in ('jax', 'numpy', 'matplotlib', 'sqlalchemy', 'rich.console', 'gymnasium') "
        "if m in sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == ""


def test_a_page_loads_nothing_that_takes_long() -> None:
    code = "import sys, hiprl.cli.serving; print({'jax', 'matplotlib', 'scipy', 'mujoco'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_a_page_has_all_pictures() -> None:
    assert ("overview", *PICTURES) == serving.DRAWN


def test_choices_are_those_of_the_library() -> None:
    from hiprl.cli.training import SEARCHES

    assert get_args(commands.Optimism) == OPTIMISM
    assert get_args(commands.Preset) == PRESETS
    assert get_args(commands.Plan) == PLANS
    assert set(get_args(commands.Search)) == set(SEARCHES)


def test_defaults_in_the_help_are_those_of_the_presets(capsys: pytest.CaptureFixture[str]) -> None:
    main(["train", "--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    default, paper = preset("default", "Hopper-v5"), preset("paper", "Hopper-v5")
    kind = {"GradientConfig": "gradient", "PPOConfig": "ppo"}
    for one, other in (
        (default.optimism, paper.optimism),
        (kind[type(default.search).__name__], kind[type(paper.search).__name__]),
        (default.plan.kind, paper.plan.kind),
    ):
        assert f"(default: {one}; with preset paper: {other})" in shown
    assert f"(default: {default.comparisons})" in shown


@pytest.mark.parametrize("flag", ["optimism", "search", "plan", "ask"])
@pytest.mark.parametrize("word", ["hope", "None"])
def test_a_word_that_is_no_choice_is_told_those_that_are(flag: str, word: str, capsys: pytest.CaptureFixture[str]):
    words = get_args(getattr(commands, flag.title()))
    assert main(["train", "Hopper-v5", f"--{flag}", word]) == WRONG_INPUT
    said = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert f"got '{word}'; it is one of {', '.join(words)}. Choose one of these." in said
    for right in words:
        assert getattr(read(["train", "Hopper-v5", f"--{flag}", right]), flag) == right


def test_a_flag_that_is_left_out_has_its_default() -> None:
    assert read(["train", "Hopper-v5"]) == commands.Train(env="Hopper-v5")
    assert read(["show"]) == commands.Show()
    assert read(["compare", "a", "b", "--store", "x", "--store", "y"]) == commands.Compare(
        runs=("a", "b"), store=("x", "y")
    )
    assert read(["compare", "--store", "x", "a", "b"]).runs == ("a", "b")


def test_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == DONE
    assert capsys.readouterr().out.strip().count(".") == 2


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["trian", "Hopper-v5"],
        ["train"],
        ["train", "Hopper-v5", "--comparisons", "many"],
        ["train", "Hopper-v5", "--comparison", "3"],
        ["train", "Hopper-v5", "--optimism", "hope"],
        ["train", "Hopper-v5", "--json", "yes"],
        ["resume"],
    ],
)
def test_a_line_that_cannot_be_read_is_wrong_input(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == WRONG_INPUT
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "--help" in shown.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["Hoper-v5"], "Did you mean"),
        (["CartPole-v1"], "action"),
        (["linear", "--judge", "noisy"], "noisy:STD"),
        (["linear", "--judge", "noisy:-3"], "noisy:STD"),
        (["linear", "--comparisons", "0"], "--comparisons"),
        (["linear", "--horizon", "0"], "--horizon"),
        (["linear", "--eval-episodes", "0"], "--eval-episodes"),
        (["linear", "--seed", str(2**70)], "32 bits"),
        (["linear", "--terminates", "nowhere:rule"], "nowhere"),
        (["linear:size=3"], "noise_std"),
        (["nowhere:make"], "nowhere"),
    ],
)
def test_input_that_cannot_be_used_is_wrong_input(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *words, "--store", str(tmp_path / "runs.db")]) == WRONG_INPUT
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("error: ")
    assert said in shown.err
    assert "Traceback" not in shown.err


def test_a_store_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.db").write_text("no database at all, but long enough to have a header " * 20)
    (tmp_path / "file").touch()
    for where, status in (
        (tmp_path, WRONG_INPUT),
        (tmp_path / "file" / "runs.db", WRONG_INPUT),
        ("mysql://host/runs", WRONG_INPUT),
        (tmp_path / "text.db", FAILED),
    ):
        assert main(["train", "linear", "--store", str(where)]) == status
        assert capsys.readouterr().err.startswith("error: ")
    for command in ("resume", "show", "compare"):
        assert main([command, "some", "--store", str(tmp_path / "none.db")]) == WRONG_INPUT
        assert "there is no store" in capsys.readouterr().err
    assert not (tmp_path / "none.db").exists()


def test_runs_that_cannot_be_resumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = str(tmp_path / "runs.db")
    with open_store(where) as store:
        finished = add_run(store, env="linear")
        by_function = add_run(store, env="linear", judge="custom", episodes=3, finished=False)
        for words, said in (
            (["nothing"], "there is no run"),
            ([finished], "is finished"),
            ([by_function], f"hiprl.resume('{by_function}', judge)"),
        ):
            assert main(["resume", *words, "--store", where]) == WRONG_INPUT
            assert said in capsys.readouterr().err
        running = add_run(store, env="linear", episodes=0, finished=False)
        with store.lease(running):
            assert main(["resume", running, "--store", where]) == WRONG_INPUT
        assert "is being trained" in capsys.readouterr().err


def test_an_expected_error_is_its_message_and_its_notes(capsys: pytest.CaptureFixture[str]) -> None:
    error = StoreError("the disk is full")
    error.add_note("Go on with: hiprl resume x")
    assert run(fails(error), as_json=False) == FAILED
    assert capsys.readouterr().err == "error: the disk is full\nGo on with: hiprl resume x\n"
    assert run(fails(InputError("no")), as_json=False) == WRONG_INPUT


def test_an_unexpected_error_says_how_to_report_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = fails(ZeroDivisionError("division\nby zero"))
    assert run(failing, as_json=False) == FAILED
    shown = capsys.readouterr().err
    assert "ZeroDivisionError: division by zero" in shown
    assert "HIPRL_TRACEBACK=1" in shown
    assert "Traceback" not in shown
    monkeypatch.setenv("HIPRL_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        run(failing, as_json=False)


def test_ctrl_c_has_an_exit_status_of_its_own() -> None:
    assert run(fails(KeyboardInterrupt()), as_json=False) == 130


def says() -> dict:
    sys.stdout.write("a table\n")
    return {"run": "x", "return_mean": None}


def test_json_is_the_last_line_of_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(says, as_json=True) == DONE
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == {"run": "x", "return_mean": None}
    assert run(says, as_json=False) == DONE
    assert capsys.readouterr().out == "a table\n"


@pytest.mark.slow
def test_a_pipe_that_is_closed_is_no_bug(tmp_path: Path) -> None:
    where = tmp_path / "runs.db"
    with open_store(where) as store:
        add_run(store)
    command = [sys.executable, "-m", "hiprl", "show", "--store", str(where), "--out", str(tmp_path)]
    done = subprocess.run(f"{' '.join(command)} | true", shell=True, capture_output=True, text=True, check=True)
    assert "error" not in done.stderr
    assert "Traceback" not in done.stderr


def test_commands_hold_plain_values() -> None:
    for command in COMMANDS.values():
        for field in dataclasses.fields(command):
            assert field.default is dataclasses.MISSING or isinstance(field.default, (str, int, tuple, type(None)))
