"""How far a run is: a live line on a terminal, plain lines elsewhere. All of it goes to stderr."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

Facts = dict[str, Any]

RECENT = 5  # episodes, by which the time left is judged


class Tally:
    """What there is to say about a run that goes on."""

    def __init__(self, K: int, past: Sequence[Facts] = ()):
        self.K = K
        self.done = 0
        self._seconds: list[float] = []
        self._returns: dict[int, float | None] = {}
        self._last: Facts = {}
        for facts in past:
            self.add(facts)
        self._seconds.clear()  # another machine, another hour: they say nothing of this one

    def add(self, facts: Facts) -> None:
        """One more episode is finished."""
        self.done = facts["k"]
        self._last = facts
        self._returns[facts["k"]] = facts["true_return"]
        if facts["searched"]:
            self._seconds.append(sum(facts["seconds"].values()))

    @property
    def returns(self) -> str:
        """The newest return, and the best one by the learned reward, as far as they are known."""
        newest = self._last.get("true_return")
        if newest is None:
            return ""
        best = self._returns.get(self._last.get("best_trajectory", -1))
        return f"return {newest:.1f}" + ("" if best is None else f", best by the learned reward {best:.1f}")

    @property
    def left(self) -> str:
        """The time left, in words; unknown until an episode has had a search of which nothing is compiled anew."""
        if self.done >= self.K or len(self._seconds) < 2:
            return ""
        return f"{duration(median(self._seconds[1:][-RECENT:]) * (self.K - self.done))} left"

    @property
    def phase(self) -> str:
        """What is being done now."""
        if self.done >= self.K:
            return "evaluating"
        return "learning" if self._last.get("searched") else "warming up"


class Lines:
    """One line an episode."""

    def __init__(self, tally: Tally, console: Console):
        self._tally = tally
        self._console = console

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Nothing is left on the screen."""

    def __call__(self, facts: Facts) -> None:
        """Tells of an episode."""
        tally = self._tally
        tally.add(facts)
        counted = f"episode {tally.done}/{tally.K}, {facts['comparisons']} comparisons"
        words = ", ".join(part for part in (counted, tally.returns, tally.left) if part)
        self._console.print(words, highlight=False, soft_wrap=True)
        if tally.done >= tally.K:
            self._console.print("evaluating the learned policy", highlight=False)


class Live:
    """One line that is kept up to date."""

    def __init__(self, tally: Tally, console: Console):
        self._tally = tally
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.fields[phase]}"),
            BarColumn(bar_width=24),
            TextColumn("{task.completed:.0f}/{task.total:.0f} comparisons"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[words]}", style="dim"),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task("", total=tally.K, completed=tally.done, phase=tally.phase, words="")

    def __enter__(self) -> Live:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Clears the line, and gives the cursor back."""
        self._bar.stop()

    def __call__(self, facts: Facts) -> None:
        """Tells of an episode."""
        tally = self._tally
        tally.add(facts)
        words = "; ".join(part for part in (tally.left, tally.returns) if part)
        self._bar.update(self._task, completed=tally.done, phase=tally.phase, words=words)


def progress(K: int, past: Sequence[Facts], console: Console) -> Lines | Live:
    """What tells of a run's episodes, as the console can show it; call it with the facts of each."""
    return (Live if console.is_interactive else Lines)(Tally(K, past), console)


def duration(seconds: float | int) -> str:
    """A time in two units at the most: 41 s, 3 min 20 s, 2 h 5 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
