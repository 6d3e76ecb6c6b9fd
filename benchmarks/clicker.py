"""A scripted person at the real page: a browser, eyes on the clips alone, and keys.

Needs Playwright (in hiprl's extra `dev`) and a Chromium of the system.
"""

from __future__ import annotations

import base64
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

CHROMIUM = next((at for name in ("chromium", "chromium-browser", "google-chrome") if (at := shutil.which(name))), None)
FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-background-networking"]
SEEN = 0.05  # difference of two clips that a person sees, over the spread of all clips seen so far
STARTING = 120.0  # seconds for a page to come up on a busy machine


class Started(NamedTuple):
    """A `hiprl teach` or `hiprl serve` in a process of its own."""

    process: subprocess.Popen
    address: str
    """That it printed; it lets one browser in."""
    said: list[str]
    """What it wrote to stderr so far, line by line."""


@contextmanager
def started(*words: str, env: dict[str, str] | None = None) -> Iterator[Started]:
    """Runs `hiprl` with these words, which show a page."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hiprl", *words],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env=os.environ | (env or {}),
    )
    said: list[str] = []
    listener = threading.Thread(target=lambda: said.extend(iter(process.stderr.readline, "")), daemon=True)
    listener.start()
    try:
        until = time.monotonic() + STARTING
        while not any(line.startswith("Open ") for line in said):
            if time.monotonic() > until or process.poll() is not None:
                raise RuntimeError(f"no page came up: {''.join(said)}")
            time.sleep(0.1)
        address = next(line for line in said if line.startswith("Open ")).removeprefix("Open ").strip()
        yield Started(process, address, said)
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        listener.join()
        process.stdout.close()
        process.stderr.close()


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser without a window, with WebGL in software."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


class Person:
    """Looks at what the page was sent about each pair, and answers with the keys of the page."""

    def __init__(self, page: Any, better: Callable[[np.ndarray], float], *, frame: tuple[int, ...]):
        """Who wants something.

        Args:
            page: the browser's.
            better: a number for the frames of a clip; more is more what is wanted.
            frame: shape of one: (bodies, 7) poses, or (p,) states where no bodies are to be seen.
        """
        self.page, self.better, self.frame = page, better, frame
        self.worths: list[float] = []
        """Of all clips seen so far: what is much is judged by what there is."""
        self.shown: dict | None = None
        self.taken = 0
        """Answers that arrived."""
        self.waits: list[float] = []
        """Seconds from each answer to the next pair."""
        page.on("response", self._look)

    def _look(self, response: Any) -> None:
        from playwright.sync_api import Error

        if "/next?" in response.url and response.ok:
            try:
                question = response.json()["question"]
            except Error:  # the page was closed before all of it was there
                return
            self.shown = question or self.shown
        self.taken += response.ok and response.request.method == "POST" and response.url.endswith("/answers")

    def leave(self) -> None:
        """Closes the page; a pair that is still on its way is not looked at."""
        self.page.remove_listener("response", self._look)
        self.page.close()

    def worth(self, clip: dict) -> float:
        """How good a clip is."""
        sent = clip["poses"] if "poses" in clip else clip["states"]
        return self.better(np.frombuffer(base64.b64decode(sent), "<f4").reshape(-1, *self.frame))

    def key(self) -> str:
        """One of five levels, 1 the left much better to 5 the right, or a side where a little is to be seen."""
        left, right = map(self.worth, self.shown["clips"])
        self.worths += [left, right]
        gap = (right - left) / (float(np.std(self.worths)) or 1.0)
        level = round(min(max(1.5 * gap, -2), 2))
        if not level and abs(gap) > SEEN:
            return "ArrowRight" if gap > 0 else "ArrowLeft"
        return str(3 + level)

    def answer(self, n: int, *, pause: float = 0.5, patience: float = 300.0) -> int:
        """Answers so many questions, or as many as there are; gives how many there were, when all have arrived."""
        taken = self.taken
        for done in range(n):
            began, before = time.monotonic(), self.shown
            while self.shown is before and self.shown is not None and done:
                if time.monotonic() - began > patience:
                    return done
                self.page.wait_for_timeout(50)
            while self.shown is None:
                if time.monotonic() - began > patience:
                    return done
                self.page.wait_for_timeout(50)
            if done:
                self.waits.append(time.monotonic() - began)
            self.page.wait_for_timeout(1000 * pause)
            self.page.keyboard.press(self.key())
        began = time.monotonic()
        while self.taken < taken + n:
            if time.monotonic() - began > patience:
                raise TimeoutError(f"of {n} answers {self.taken - taken} arrived within {patience:.0f} s")
            self.page.wait_for_timeout(50)
        return n
