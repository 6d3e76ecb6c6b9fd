"""How far a run is: a live line on a terminal, plain lines elsewhere. All of it goes to stderr."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from hiprl.data.facts import enough

Facts = dict[str, Any]

RECENT = 5  # episodes, by which the time left is judged
ENOUGH = (
    "Answers are hardly worth giving any more: what is wanted is known so well that the next one is expected to change "
    "the best by less than 1 %. The run goes on, as more episodes still make it better at it."
)


class Tally:
    """What there is to say about a run that goes on."""

    def __init__(self, K: int, past: Sequence[Facts] = (), *, by_people: bool = False):
        self.K = K
        self.by_people = by_people
        self.done = 0
        self._seconds: list[float] = []
        self._episodes: list[Facts] = []
        for facts in past:
            self.add(facts)
        self._seconds.clear()  # another machine, another hour: they say nothing of this one

    def add(self, facts: Facts) -> None:
        """One more episode is finished."""
        self.done = facts["comparisons"]
        self._episodes.append(facts)
        if facts["searched"]:
            self._seconds.append(sum(facts["seconds"].values()))

    @property
    def _last(self) -> Facts:
        return self._episodes[-1] if self._episodes else {}

    @property
    def returns(self) -> str:
        """The newest return, and the best one by the learned reward, as far as they are known."""
        newest = self._last.get("true_return")
        if newest is None:
            return ""
        best = self._last.get("best_return")
        return f"return {newest:.1f}" + ("" if best is None else f", best by the learned reward {best:.1f}")

    @property
    def enough(self) -> bool:
        """Whether the last answers were hardly worth giving."""
        return enough(self._episodes)

    @property
    def left(self) -> str:
        """The time left, in words; unknown until an episode has had a search of which nothing is compiled anew."""
        if self.by_people or self.done >= self.K or len(self._seconds) < 2:
            return ""
        return f"{duration(median(self._seconds[1:][-RECENT:]) * (self.K - self.done))} left"

    @property
    def counted(self) -> str:
        """How far it is, in numbers."""
        if self.by_people:
            return f"episode {self._last['k']}, {self.done} of {self.K} answers"
        return f"episode {self.done}/{self.K}, {self.done} comparisons"

    @property
    def phase(self) -> str:
        """What is being done now."""
        if self.done >= self.K:
            return "practising" if self.by_people else "evaluating"
        return "learning" if self._last.get("searched") else "warming up"


class Lines:
    """One line an episode."""

    def __init__(self, tally: Tally, console: Console):
        self._tally = tally
        self._console = console
        self._said = tally.enough

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Nothing is left on the screen."""

    def wait(self, what: str) -> None:
        """Tells what is waited for."""
        if what:
            self._console.print(f"waiting for {what}", highlight=False)

    def __call__(self, facts: Facts) -> None:
        """Tells of an episode."""
        tally = self._tally
        tally.add(facts)
        words = ", ".join(part for part in (tally.counted, tally.returns, tally.left) if part)
        self._console.print(words, highlight=False, soft_wrap=True)
        if tally.enough and not self._said:
            self._console.print(ENOUGH, highlight=False, soft_wrap=True)
            self._said = True
        if tally.done >= tally.K and not tally.by_people:
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

    def wait(self, what: str) -> None:
        """Tells what is waited for."""
        self._bar.update(self._task, words=f"waiting for {what}" if what else "")

    def __call__(self, facts: Facts) -> None:
        """Tells of an episode."""
        tally = self._tally
        tally.add(facts)
        hardly = "answers are hardly worth giving any more" if tally.enough else ""
        words = "; ".join(part for part in (tally.left, tally.returns, hardly) if part)
        self._bar.update(self._task, completed=tally.done, phase=tally.phase, words=words)


def progress(K: int, past: Sequence[Facts], console: Console, *, by_people: bool = False) -> Lines | Live:
    """What tells of a run's episodes, as the console can show it; call it with the facts of each."""
    return (Live if console.is_interactive else Lines)(Tally(K, past, by_people=by_people), console)


def duration(seconds: float | int) -> str:
    """A time in two units at the most: 41 s, 3 min 20 s, 2 h 5 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
