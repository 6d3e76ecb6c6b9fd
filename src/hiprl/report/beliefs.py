"""What the learned reward believes, as a picture: "what I think you want"."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hiprl.models.quality import Shape
from hiprl.report.style import BLUE, GREY, look, new_figure

MOST = 6  # entries of state and action that are shown
NORMAL_90 = 1.6449


def beliefs(shapes: Shape, unit: float, names: Sequence[str], headline: str, *, going_on: float = 0.0) -> Figure:
    """What the posterior rewards, one panel for each of the entries of (s, a) that count most.

    Args:
        shapes: of the posterior, one a coordinate.
        unit: a typical reward, so that a height of 1 is one.
        names: of the coordinates.
        headline: what the run is.
        going_on: what every step is worth, whatever it is like, in the unit of r̂.
    """
    weights = np.asarray(shapes.weight)
    order = np.argsort(-weights)[:MOST]
    total = weights.sum() + abs(going_on) or 1.0
    share = weights / total
    columns = 3 if len(order) > 2 else len(order)
    rows = -(-len(order) // columns)
    with look():
        figure, axes = new_figure(rows, columns, width=3.1 * columns, height=1.1 + 2.1 * rows)
        x, mean, std = (np.asarray(part) for part in (shapes.x, shapes.mean, shapes.std))
        top = np.abs(np.stack([mean - NORMAL_90 * std, mean + NORMAL_90 * std])[:, order]).max() / unit * 1.05
        for place in axes.flat[len(order) :]:
            place.set_visible(False)
        for j, place in zip(order, axes.flat, strict=False):
            draw(place, x[j], mean[j] / unit, std[j] / unit)
            place.set_title(f"{names[j]}: {100 * share[j]:.0f} %")
            place.set_ylim(-top, top)
            place.set_xlabel("its value")
        for place in axes[:, 0]:
            place.set_ylabel("reward a step")
        words = "What it thinks you want: up is better, 1 is a typical reward; band: 90 % of the belief. "
        if going_on:
            kept = "goes on" if going_on > 0 else "ends"
            words += f"Of what counts, {100 * abs(going_on) / total:.0f} % is that it {kept} at all. "
        words += headline
        figure.suptitle(textwrap.fill(words, 34 * columns), x=0.01, ha="left", fontsize=9, color=GREY)
    return figure


def draw(axes: Axes, x: np.ndarray, mean: np.ndarray, std: np.ndarray) -> None:
    """One coordinate: the belief about what it is worth, over the values seen."""
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.fill_between(x, mean - NORMAL_90 * std, mean + NORMAL_90 * std, color=BLUE, alpha=0.18, linewidth=0)
    axes.plot(x, mean, color=BLUE)
