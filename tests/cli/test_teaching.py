"""How `hiprl teach` begins, and what it says to go on with."""

from __future__ import annotations

import contextlib
import io
import queue
import socket
import subprocess
from pathlib import Path

import pytest

from hiprl.cli import serving, teaching
from hiprl.cli.commands import Resume, Teach
from hiprl.cli.serving import known_as
from hiprl.cli.training import typed
from hiprl.errors import InputError
from hiprl.session import spec_of
from hiprl.store.store import open_store


def test_clips_of_no_steps_are_whole_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(teaching, "follow", lambda store, run_id, *_: asked.append(spec_of(store, run_id)) or {})
    store = str(tmp_path / "runs.db")
    for clip in (0, 30, None):
        teaching.teach(Teach(env="linear", clip=clip, port=0, store=store))
    assert [spec.config.question.clip for spec in asked] == [None, 30, 50]


def test_most_answers_are_about_what_was_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(teaching, "follow", lambda store, run_id, *_: asked.append(spec_of(store, run_id)) or {})
    for K in (2, 8, 16, 30, 90):
        teaching.teach(Teach(env="linear", comparisons=K, port=0, store=str(tmp_path / "runs.db")))
    assert [spec.config.warm_up for spec in asked] == [2, 4, 5, 10, 10]


@pytest.mark.parametrize("where", [{"port": 99999}, {"host": "203.0.113.7", "port": 8790}])
def test_a_page_that_cannot_be_there_leaves_no_run(tmp_path: Path, where: dict) -> None:
    path = tmp_path / "runs.db"
    with pytest.raises(InputError, match="port"):
        teaching.teach(Teach(env="linear", store=str(path), **where))
    assert not path.exists()


def test_the_page_stays_until_the_end_was_heard_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited = []
    final = {"env": "linear", "comparisons": 6, "wall_seconds": 1.0, "return_mean": None}
    monkeypatch.setattr(teaching, "taught", lambda *_, **more: final)
    monkeypatch.setattr(teaching.time, "sleep", waited.append)
    monkeypatch.setattr(teaching.sys, "stdin", io.StringIO())
    monkeypatch.setattr(teaching, "page", lambda *_: contextlib.nullcontext())
    for port in (0, 8790):
        teaching.teach(Teach(env="linear", comparisons=6, port=port, store=str(tmp_path / "runs.db")))
    assert waited == [teaching.HEARD]


def test_words_on_a_terminal_take_the_place_of_the_live_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for terminal in (True, False):
        err = io.StringIO()
        err.isatty = lambda terminal=terminal: terminal
        monkeypatch.setattr(serving.sys, "stderr", err)
        serving.say("Open it")
        assert err.getvalue() == ("\r\x1b[KOpen it\n" if terminal else "Open it\n")


def test_imagined_clips_are_asked_for_where_they_can_be_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(teaching, "follow", lambda store, run_id, *_: asked.append(spec_of(store, run_id)) or {})
    store = str(tmp_path / "runs.db")
    for env in ("Hopper-v5", "linear"):  # bodies; states alone, which are shown as curves
        teaching.teach(Teach(env=env, imagined=True, port=0, store=store))
    with pytest.raises(InputError, match=r"got --imagined for Reacher-v5.*joints.*Leave --imagined out"):
        teaching.teach(Teach(env="Reacher-v5", imagined=True, port=0, store=store))
    assert [spec.config.question.imagined for spec in asked] == [True, True]
    with open_store(store, create=False) as opened:
        assert len(opened.runs()) == 2


def test_a_taught_run_is_resumed_with_its_page_where_it_was(tmp_path: Path) -> None:
    with open_store(tmp_path / "runs.db") as store:
        there = Teach(env="linear", host="0.0.0.0", port=9000, no_browser=True)
        flags = "--host 0.0.0.0 --port 9000 --no-browser"
        assert typed("resume", "a-run", store, there) == f"hiprl resume a-run {flags}"
        assert typed("resume", "a-run", store, Resume(run="a", port=0)) == "hiprl resume a-run --port 0"
        assert typed("show", "a-run", store, there) == "hiprl show a-run"
        assert typed("resume", "a-run", store, Teach(env="linear")) == "hiprl resume a-run"


def test_a_page_that_ends_by_itself_is_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages: list[subprocess.Popen[bytes]] = []
    told: queue.Queue[str] = queue.Queue()
    begin = subprocess.Popen

    def began(*words, **options):
        pages.append(begin(*words, **options))
        return pages[-1]

    monkeypatch.setattr(teaching.subprocess, "Popen", began)
    monkeypatch.setattr(teaching, "say", told.put)
    monkeypatch.setattr(teaching, "follow", lambda *_: {})
    there = Teach(env="linear", port=8790, store=str(tmp_path / "runs.db"), no_browser=True)
    teaching.teach(there)  # its own end is no news
    assert not any("has ended" in told.get() for _ in range(told.qsize()))

    def missed(*_):
        pages[-1].kill()
        while "has ended" not in (said := told.get(timeout=60)):
            pass
        return {"said": said}

    monkeypatch.setattr(teaching, "follow", missed)
    said = teaching.teach(there)["said"]
    assert "The page has ended (exit -9); what was answered is stored, and the run goes on." in said
    assert "hiprl serve linear-" in said and "--port 8790" in said


def test_a_page_for_all_is_told_by_the_name_of_the_machine() -> None:
    assert known_as("0.0.0.0") == known_as("::") == socket.gethostname()
    assert known_as("127.0.0.1") == known_as("::1") == "localhost"
    assert (known_as("192.0.2.1"), known_as("2001:db8::1")) == ("192.0.2.1", "[2001:db8::1]")
    assert known_as("127.0.0.2") == "127.0.0.2"  # where nothing answers as localhost


@pytest.mark.parametrize("goal", ["", " ", "stand \u202e up", "\udcff", "x" * 501])
def test_a_goal_that_the_page_would_refuse_is_refused_before_a_run_is_stored(tmp_path, goal: str) -> None:
    store = tmp_path / "runs.db"
    with pytest.raises(InputError, match=r"^Say what is wanted"):
        teaching.teach(Teach(env="linear", store=str(store), port=0, goal=goal))
    assert not store.exists()
