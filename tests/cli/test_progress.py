from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from hiprl.cli.progress import Lines, Live, Tally, duration, progress
from tests.report.made_up import facts


def told(n: int, *, pays: bool = True) -> list[dict]:
    draw = np.random.default_rng(5)
    return [facts(k, warm_up=3, draw=draw, pays=pays) for k in range(1, n + 1)]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (200, "3 min 20 s"), (3600, "1 h 0 min"), (7507, "2 h 5 min")],
)
def test_durations_in_words(seconds: float | int, words: str) -> None:
    assert duration(seconds) == words


def test_the_time_left_is_that_of_the_episodes_that_compiled_nothing() -> None:
    tally = Tally(9)
    for k, one in enumerate(told(7), 1):
        one["seconds"] = {"propose": 100.0 if k == 3 else 7.0, "learn": 1.0}
        tally.add(one)
        assert tally.left == ("" if k < 4 else f"{duration(8 * (9 - k))} left")


def test_the_best_return_is_that_of_the_trajectory_the_reward_ranks_best() -> None:
    tally = Tally(9)
    past = told(5)
    past[-1]["best_return"] = past[3]["true_return"]
    for one in past:
        tally.add(one)
    newest, best = past[4]["true_return"], past[3]["true_return"]
    assert tally.returns == f"return {newest:.1f}, best by the learned reward {best:.1f}"


def test_phases() -> None:
    tally = Tally(4)
    assert tally.phase == "warming up"
    for one, phase in zip(told(4), ("warming up", "warming up", "learning", "evaluating"), strict=True):
        tally.add(one)
        assert tally.phase == phase


def test_without_a_terminal_there_is_a_line_an_episode() -> None:
    screen = io.StringIO()
    with progress(4, told(1), Console(file=screen)) as display:
        assert isinstance(display, Lines)
        for one in told(4)[1:]:
            display(one)
    lines = screen.getvalue().splitlines()
    assert [line.split(",")[0] for line in lines] == [
        "episode 2/4",
        "episode 3/4",
        "episode 4/4",
        "evaluating the learned policy",
    ]
    assert "2 comparisons, return " in lines[0]
    assert "\x1b" not in screen.getvalue()


def test_an_environment_that_pays_nothing_has_no_return_to_tell() -> None:
    screen = io.StringIO()
    with progress(4, [], Console(file=screen)) as display:
        for one in told(3, pays=False):
            display(one)
    assert "return" not in screen.getvalue()


def test_a_terminal_has_a_live_line_and_gets_its_cursor_back() -> None:
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=150)
    with progress(4, told(2), console) as display:
        assert isinstance(display, Live)
        for one in told(4)[2:]:
            display(one)
    assert "4/4 comparisons" in screen.getvalue()
    assert screen.getvalue().rindex("\x1b[?25h") > screen.getvalue().rindex("\x1b[?25l")
