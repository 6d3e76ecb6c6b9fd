"""`hiprl play`: what is written, and where; the policy is made up."""

from __future__ import annotations

import json
from pathlib import Path

import jax.numpy as jnp
import pytest

from hiprl.cli import playing
from hiprl.cli.main import main
from hiprl.control.policy import Uniform
from hiprl.store.store import open_store
from tests.world.test_camera import Painted

PAINTED = "tests.world.test_camera:Painted"


@pytest.fixture
def where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A store with a run of a MuJoCo body and one of an environment that draws itself."""
    monkeypatch.setattr(playing, "learned_actor", lambda store, run_id, world: Uniform(jnp.ones(()), world.q))
    path = tmp_path / "runs.db"
    with open_store(path) as store:
        for env in ("InvertedPendulum-v5", PAINTED):
            store.add_run(env, 0, {"env": env, "horizon": 8, "terminates": None}, {})
    return str(path)


def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that a browser is given from now on."""
    addresses: list[str] = []
    monkeypatch.setattr(playing, "graphical", lambda: True)
    monkeypatch.setattr(playing.webbrowser, "open", addresses.append)
    return addresses


def test_what_is_played_alone_is_written_beside_the_store_and_opened(where: str, monkeypatch, capsys):
    addresses = opened(monkeypatch)
    assert main(["play", "inverted", "--store", where, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    path = Path(told["file"])
    assert addresses == [path.resolve().as_uri()] and path.parent == Path(where).parent / told["run"]
    text = path.read_text(encoding="utf-8")
    assert told["video"] is None and told["bytes"] == path.stat().st_size < 2_000_000
    assert "http://" not in text.split("<script>")[0] and "InvertedPendulum-v5" in text


def test_a_video_and_a_page_show_the_same_episode(where: str, tmp_path: Path, monkeypatch, capsys):
    addresses = opened(monkeypatch)
    video, page = tmp_path / "walk.mp4", tmp_path / "walk.html"
    words = ["play", "tests", "--store", where, "--video", str(video), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["file"] is None and told["video"] == str(video) and told["length"] == 8
    assert video.read_bytes()[4:8] == b"ftyp" and told["bytes"] == video.stat().st_size
    assert main([*words, "--html", str(page)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["file"], told["length"]) == (str(page), 8)
    assert told["bytes"] == video.stat().st_size + page.stat().st_size
    assert not addresses  # what was named is not opened


def test_what_is_wrong_is_said_before_anything_is_executed(where: str, monkeypatch, capsys):
    monkeypatch.setattr(Painted, "step", None)
    assert main(["play", "tests", "--store", where, "--video", "walk.gif"]) == 2
    assert "only MP4 is written" in capsys.readouterr().err
    assert main(["play", "tests", "--store", where, "--steps", "0"]) == 2
    assert "at least 1 is needed" in capsys.readouterr().err
