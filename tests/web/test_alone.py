from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.clicker import CHROMIUM, chromium
from hiprl.data.film import Film
from hiprl.web.alone import page_of
from tests.web.made import SCENE, poses


def test_a_file_holds_all_that_it_needs():
    text = page_of(SCENE, [("now", Film(poses=poses(2, 20)))], "Hopper </script><b>& co")
    told = json.loads(re.search(r'<script type="application/json" id="told">(.*?)</script>', text)[1])
    assert told["scene"] == SCENE and told["title"] == "Hopper </script><b>& co"
    found = np.frombuffer(base64.b64decode(told["clips"][0]["poses"]), "<f4").reshape(-1, 3, 7)
    np.testing.assert_array_equal(found, poses(2, 20))
    assert not re.search(r"""(src|href)\s*=\s*["']?https?:""", text) and "<b>&" not in text
    assert len(text) < 2_000_000


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is here (Debian: apt-get install chromium)")
def test_it_plays_in_a_browser(tmp_path: Path):
    path = tmp_path / "play.html"
    path.write_text(page_of(SCENE, [("", Film(poses=poses(2, 40)))], "Hopper"), encoding="utf-8")
    with chromium() as browser:
        page = browser.new_page()
        troubles: list[str] = []
        page.on("console", lambda m: troubles.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: troubles.append(str(e)))
        page.goto(path.as_uri())
        page.wait_for_selector("#player canvas", timeout=60_000)
        page.wait_for_timeout(500)
        assert "Hopper" in page.inner_text("#player") and not troubles
        playing = lambda: page.get_attribute(".hp-play", "aria-label") == "Pause"
        for hand in (lambda: page.keyboard.press(" "), lambda: page.click("canvas"), lambda: page.click(".hp-play")):
            was = playing()
            hand()
            assert playing() != was
            page.keyboard.press(" ")
            assert playing() == was


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is here (Debian: apt-get install chromium)")
@pytest.mark.parametrize("apart", [0.05, 9.0])
def test_what_hardly_moves_is_looked_at_from_near(tmp_path: Path, apart: float):
    one, other = poses(0, 40), poses(0, 40)
    one[:, 1, 2] += 0.01 * np.arange(41)  # it rises a little, and goes nowhere
    other[:, 1:, 0] += apart
    path = tmp_path / "play.html"
    path.write_text(page_of(SCENE, [("", Film(poses=one)), ("", Film(poses=other))], "Hopper"), encoding="utf-8")
    with chromium() as browser:
        page = browser.new_page()
        page.goto(path.as_uri())
        view = page.evaluate(
            """() => {
              const told = JSON.parse(document.getElementById("told").textContent);
              return window.hiprlPlayer(document.createElement("div"), told).stage.view;
            }"""
        )
    (x, *_), (x_other, *_) = view["targets"][0][0], view["targets"][1][0]
    assert not view["travels"] and view["box"][0] < 0.3  # a ball about the larger body has 0.25
    if apart > 1:
        assert (x, x_other) == pytest.approx((0, apart), abs=1e-4)  # each in the middle of its picture
    else:
        assert x == x_other == pytest.approx(apart / 2, abs=1e-4)  # both from the same place
