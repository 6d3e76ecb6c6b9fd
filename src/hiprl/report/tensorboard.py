"""TensorBoard event files, written as the episodes of a run arrive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hiprl.errors import InputError
from hiprl.report.record import Facts

GROUPS = {
    "return": ("true_return", "return_by_reward"),
    "answer": ("g", "g_predicted", "sigma_g", "alpha", "foreseen", "worth"),
    "dynamics": ("beta", "kappa", "deviation", "relative_error", "coverage"),
    "search": ("imagined", "imagined_worst", "executed", "overpromised"),
    "episode": ("length", "env_steps", "best_trajectory"),
}
"""Where each fact is shown. `rollout_errors` and `seconds` are groups of their own."""


class EventFiles:
    """The event files of one run; its steps are comparisons. Call it with the facts of each episode."""

    def __init__(self, folder: str | Path, run_id: str, past: Sequence[Facts] = ()):
        """Begins to write.

        Args:
            folder: where the run gets a folder of its own.
            run_id: of the run, and the name of its folder.
            past: episodes that are finished already; written unless there are event files of this run.
        """
        place = Path(folder).expanduser() / run_id
        again = any(place.glob("events.out.tfevents.*"))
        # The suffix keeps two trainers of one second apart. A thread writes what is a second old.
        self._writer = writer_class()(str(place), flush_secs=1, filename_suffix=f".{len(past)}")
        for facts in () if again else past:
            self(facts)

    def __call__(self, facts: Facts) -> None:
        """Writes what is known of an episode."""
        for group, names in GROUPS.items():
            self._write(group, {name: facts.get(name) for name in names}, facts["comparisons"])
        for group in ("rollout_errors", "seconds"):
            self._write(group, facts.get(group) or {}, facts["comparisons"])

    def close(self) -> None:
        """Writes the last of it."""
        self._writer.close()

    def _write(self, group: str, numbers: Facts, step: int) -> None:
        for name, number in numbers.items():
            if number is not None:
                self._writer.add_scalar(f"{group}/{name}", float(number), step)


def event_folder(folder: str | Path) -> Path:
    """The folder for event files, made if there is none.

    Raises:
        InputError: what writes them is not installed, or the folder cannot be made.
    """
    writer_class()
    place = Path(folder).expanduser()
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot make the folder {place} for TensorBoard ({error.strerror or error}); one that can be written is "
            "needed. Name another with --tensorboard."
        ) from error
    return place


def writer_class() -> Any:
    """What writes event files.

    Raises:
        InputError: it is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
    except ImportError as error:
        raise InputError(
            f"TensorBoard's event files were asked for, and tensorboardX is not installed ({error}); it is an extra of "
            "hiprl. Install it: pip install 'hiprl[tensorboard]'"
        ) from error
    return SummaryWriter
