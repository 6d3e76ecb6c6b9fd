"""What the benchmarks share: their flags, one core to run on, the machine in words, a table and the same as JSON."""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

PACKAGES = ("hiprl", "jax", "jaxlib", "equinox", "optax", "numpy", "gymnasium", "mujoco")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def parser(doc: str | None) -> argparse.ArgumentParser:
    """A command line that every benchmark starts from; `doc` is the module's docstring."""
    made = argparse.ArgumentParser(
        description=doc, formatter_class=type("Help", (Defaults, argparse.RawDescriptionHelpFormatter), {})
    )
    made.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers here")
    made.add_argument("--quick", action="store_true", help="sizes that only show that it runs")
    return made


class Defaults(argparse.ArgumentDefaultsHelpFormatter):
    """Says the default of each flag that has one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        return action.help if action.default in (None, False) else super()._get_help_string(action)


def add_core(made: argparse.ArgumentParser) -> None:
    """The flag that says which core to run on."""
    made.add_argument("--core", type=int, default=cores()[-1], help="number of the only core to run on; -1 for all")


def cores() -> list[int]:
    """The cores that this process may use; [-1] where the system does not say."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [-1]


def one_core(core: int) -> None:
    """Keeps this process, and those it starts, on one core. To be called before JAX or Torch is imported.

    XLA takes as many threads as there are cores to run on, so one core means one thread.
    """
    if core < 0 or not hasattr(os, "sched_setaffinity"):
        return
    os.sched_setaffinity(0, {core})
    for name in THREADS:
        os.environ[name] = "1"


class Timed(NamedTuple):
    """The best of some calls."""

    cpu: float
    """Seconds that the process computed."""
    wall: float
    """Seconds that passed; more than `cpu` where other processes want the core."""

    @property
    def seconds(self) -> float:
        """What counts: computing time on a CPU, as others may want it too; time passed on an accelerator."""
        import jax

        return self.cpu if jax.default_backend() == "cpu" else self.wall


def timed(f: Callable[[], Any], *, repeats: int) -> Timed:
    """How long `f` takes: the best of `repeats` calls, each waited for. Call it once before, to compile."""
    import jax

    runs = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        jax.block_until_ready(f())
        runs.append((time.process_time() - cpu, time.perf_counter() - wall))
    cpu, wall = zip(*runs, strict=True)
    return Timed(min(cpu), min(wall))


def machine() -> dict[str, Any]:
    """The machine, the versions and the command, for the record."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    facts: dict[str, Any] = {
        "cpu": names[0] if names else platform.processor(),
        "cores": os.cpu_count(),
        "used_cores": len(cores()),
        "load": list(os.getloadavg()),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {name: found for name in PACKAGES if (found := installed(name)) is not None},
        "command": shlex.join(["python", "-m", sys.modules["__main__"].__spec__.name, *sys.argv[1:]])
        if getattr(sys.modules["__main__"], "__spec__", None)
        else shlex.join(sys.argv),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    if "jax" in sys.modules:
        import jax

        facts["device"] = jax.devices()[0].device_kind
    return facts


def installed(name: str) -> str | None:
    """The version of a package, if it is there."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


@dataclass
class Report:
    """Rows of one benchmark: shown as a table, and written as they are."""

    title: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Sentences under the table."""

    def add(self, **row: Any) -> None:
        """One more row; its names are the table's columns."""
        self.rows.append(row)

    def show(self, columns: Sequence[str] | None = None) -> None:
        """Prints the table."""
        from rich.console import Console
        from rich.table import Table

        names = list(columns or dict.fromkeys(name for row in self.rows for name in row))
        table = Table()
        for name in names:
            numbers = all(not isinstance(row.get(name), str) for row in self.rows)
            table.add_column(name.replace("_", " "), justify="right" if numbers else "left")
        for row in self.rows:
            table.add_row(*(said(row.get(name)) for name in names))
        console = Console(width=None if sys.stdout.isatty() else 160)
        console.print(f"[bold]{self.title}[/bold]")
        console.print(table)
        for note in self.notes:
            console.print(note)

    def write(self, path: Path | None, **more: Any) -> None:
        """Writes rows, notes and machine as one JSON object, if there is a path."""
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        facts = {"title": self.title, "rows": self.rows, "notes": self.notes, **more, "machine": machine()}
        path.write_text(json.dumps(facts, indent=2, default=str) + "\n")
        print(f"Wrote {path}", file=sys.stderr)


def said(x: Any) -> str:
    """A value as the table shows it."""
    if x is None:
        return ""
    if isinstance(x, float):
        return f"{x:,.0f}" if abs(x) >= 1000 else f"{x:.3g}"
    if isinstance(x, int) and not isinstance(x, bool):
        return f"{x:,}"
    if isinstance(x, Iterable) and not isinstance(x, str):
        return " ".join(said(one) for one in x)
    return str(x)


def progress(text: str) -> None:
    """A line for who waits."""
    print(text, file=sys.stderr, flush=True)
