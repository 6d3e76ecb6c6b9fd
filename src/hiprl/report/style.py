"""How figures look: quiet axes, colours that colour-blind readers can tell apart, labels beside the lines."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from hiprl.errors import HiprlError

# Okabe and Ito (2008), in the order in which arms take them; yellow is left out, as it is pale on white.
BLUE, RED, GREEN, ORANGE, PINK, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"
COLOURS = (BLUE, RED, GREEN, ORANGE, PINK, SKY)
INK, GREY, FAINT = "#222222", "#7a7a7a", "#e4e4e4"
BLUES = ("#86bbdd", "#4f9bcb", "#2070b4", "#08306b")  # light to dark: from one step to many

LOOK = {
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 10,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.8,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.formatter.use_mathtext": True,
    "xtick.major.size": 3,
    "ytick.major.size": 0,
    "ytick.minor.size": 0,
    "lines.linewidth": 1.8,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.1,
    "legend.handletextpad": 0.45,
    "legend.columnspacing": 1.1,
    "savefig.dpi": 160,
    "svg.fonttype": "none",
}
SHORT_LOG = 2000.0  # greatest over smallest number of a logarithmic axis that is labelled in full
WIDE_RANGE = 30.0  # greatest over smallest number, from which an axis is logarithmic


def look():
    """Within it, figures that are made and saved look like ours."""
    return matplotlib.rc_context(LOOK)  # pyright: ignore[reportArgumentType]


def new_figure(rows: int, columns: int, *, width: float, height: float) -> tuple[Figure, np.ndarray]:
    """A figure that no window and no global state knows, and its axes (rows, columns). Sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.09, h_pad=0.09, wspace=0.04, hspace=0.06)  # pyright: ignore
    return figure, figure.subplots(rows, columns, squeeze=False)


def label(axes: Axes, title: str, y: str, *, x: str = "comparisons") -> None:
    """Title and the names of both axes, with their units."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))


def stretch(axes: Axes, *series: np.ndarray, low: float | None = 0.0) -> None:
    """A logarithmic axis if the numbers are positive and of very different size; one that begins at `low` if not."""
    known = np.concatenate(series)
    known = known[np.isfinite(known)]
    if len(known) and known.min() > 0 and known.max() > WIDE_RANGE * known.min():
        logarithmic(axes, known.min() / 1.3, known.max() * 1.3)
    elif low is not None:
        axes.set_ylim(bottom=low)


def logarithmic(axes: Axes, low: float, high: float) -> None:
    """A logarithmic axis with numbers that can be read: 0.2, 0.5, 1 where it is short, powers of ten where long."""
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    if high / low < SHORT_LOG:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < SHORT_LOG / 20 else (1, 3)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def legend(axes: Axes) -> None:
    """A legend in one line between title and panel, where no data can be; none if there is but one thing to tell."""
    handles, _ = axes.get_legend_handles_labels()
    if len(handles) > 1:
        line = axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 0.985), ncols=len(handles), borderpad=0.2)
        line.set_in_layout(False)
        axes.set_title(axes.get_title(loc="left"), pad=21)


def say_nothing_known(axes: Axes, why: str) -> None:
    """An empty panel that says why it is empty."""
    axes.grid(False)
    axes.set_yticks([])
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center", color=GREY)


def save(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Writes each figure as a PNG under its name; gives the files.

    Raises:
        HiprlError: the folder or a file cannot be written.
    """
    paths: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with look():
            for name, figure in figures.items():
                paths.append(folder / f"{name}.png")
                figure.savefig(paths[-1])
    except OSError as error:
        raise HiprlError(
            f"cannot write the pictures into {folder} ({error.strerror or error}); a folder that can be written, with "
            "room on its disk, is needed. Name another with --out."
        ) from error
    return paths
