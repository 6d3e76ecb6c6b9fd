"""The pictures of one run, from its facts: one panel a question."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hiprl.report.record import Record
from hiprl.report.setting import setting
from hiprl.report.style import (
    BLUE,
    BLUES,
    GREY,
    ORANGE,
    RED,
    label,
    legend,
    logarithmic,
    look,
    new_figure,
    say_nothing_known,
    stretch,
)
from hiprl.report.summary import horizons

Panel: TypeAlias = Callable[[Axes, Record], None]

NO_NUMBERS = "the judge gave no numbers"
NOMINAL = 0.9  # the share that calibrated widths cover
DOT = {"linestyle": "none", "marker": "o", "markeredgewidth": 0.0}


def pictures(run: Record) -> dict[str, Figure]:
    """Name to figure; `overview` has the most telling panels together."""
    with look():
        return {name: figure_of(run, name) for name in ("overview", *PICTURES)}


def figure_of(run: Record, name: str) -> Figure:
    """One of them."""
    return overview(run) if name == "overview" else single(run, PICTURES[name])


def overview(run: Record) -> Figure:
    """Six panels at the width of a page."""
    figure, axes = new_figure(2, 3, width=11.0, height=6.2)
    for panel, place in zip(OVERVIEW, axes.flat, strict=True):
        draw(panel, place, run)
    figure.suptitle(textwrap.fill(headline(run), 105), x=0.01, ha="left", fontsize=11.5)
    return figure


def single(run: Record, panels: tuple[Panel, ...]) -> Figure:
    """One panel, or a few below each other."""
    figure, axes = new_figure(len(panels), 1, width=6.4, height=1.4 + 2.4 * len(panels))
    for panel, place in zip(panels, axes.flat, strict=True):
        draw(panel, place, run)
    figure.suptitle(textwrap.fill(headline(run), 78), x=0.01, ha="left", fontsize=9, color=GREY)
    return figure


def headline(run: Record) -> str:
    """What the run is and what came of it."""
    settings = setting(run.row).words(most=3)
    words = f"{run.row.env}: seed {run.row.seed}, {settings}, {run.answered} comparisons"
    if run.final is None or run.final["return_mean"] is None:
        return words
    mean, std, n = (run.final[name] for name in ("return_mean", "return_std", "eval_episodes"))
    return f"{words} → return {number(mean)} ± {number(std, beside=mean)} over {n} episodes"


def number(x: float, *, beside: float = 0.0) -> str:
    """A return with as many digits as say something, and no more than what it stands beside."""
    return f"{x:.0f}" if max(abs(x), abs(beside)) >= 100 else f"{x:.3g}"


def draw(panel: Panel, axes: Axes, run: Record) -> None:
    """A panel with the warm-up in grey behind it."""
    panel(axes, run)
    if not len(run.episodes):
        say_nothing_known(axes, "no episode yet")
        return
    first = min(run.k[0], 1) - 0.6  # a person may answer first when some episodes are done
    axes.set_xlim(first, max(run.planned, run.answered) + 0.6)
    if not run.searched.all() and axes.lines:
        axes.axvspan(first, run.k[~run.searched].max() + 0.5, color="#f3f3f3", linewidth=0, zorder=0)


def learning(axes: Axes, run: Record) -> None:
    """Fig. 2: what each episode was worth, and what the policy would have been that r̂ ranks best by then."""
    if run.pays:
        executed, best, unit = run.executed, run.best, "true return of an episode"
    else:
        executed, best, unit = run.series("return_by_reward"), np.full(len(run.episodes), np.nan), "return by $\\hat r$"
    label(axes, "What it learns", unit)
    random, policy = ~run.searched, run.searched
    axes.plot(run.k[random], executed[random], **DOT, color=GREY, markersize=4, alpha=0.7)
    axes.plot(
        run.k[policy], executed[policy], **DOT, color=BLUE, markersize=4.5, alpha=0.45, zorder=3, label="executed"
    )
    if np.isfinite(best).any():
        axes.plot(run.k, best, color=BLUE, drawstyle="steps-post", label="best by $\\hat r$")
    if run.final is not None and run.final["return_mean"] is not None:
        axes.errorbar(
            run.k[-1:],
            [run.final["return_mean"]],
            [run.final["return_std"]],
            color=RED,
            fmt="D",
            markersize=5,
            capsize=3,
            linewidth=1.4,
            label="reported",
            zorder=5,
        )
    legend(axes)


def transition(axes: Axes, run: Record) -> None:
    """Fig. 3: how far the model's next state is off, before it has seen the episode."""
    label(axes, "One-step error of the dynamics", "mean $\\|s' - \\mu(s, a)\\|$\nin units of the state")
    deviation = run.series("deviation")
    if not np.isfinite(deviation).any():
        say_nothing_known(axes, "known from the first search on")
        return
    axes.plot(run.k, deviation, color=BLUE, marker="o", markersize=3.5)
    stretch(axes, deviation)


def preference(axes: Axes, run: Record) -> None:
    """Fig. 4: how far r̂ was off about an answer before it came, and how far it thought it could be."""
    label(axes, "Error of a predicted answer", "$|g - \\hat g|$ in units of the return")
    error, sigma = np.abs(run.series("g") - run.series("g_predicted")), run.series("sigma_g")
    if not np.isfinite(error).any():
        say_nothing_known(axes, NO_NUMBERS)
        return
    known = error[np.isfinite(error) & (error > 0)]
    if len(known):  # the first answers of all are predicted with a σ_g of next to nothing, which says nothing
        low, high = known.min() / 2, 2 * max(known.max(), np.nanmax(sigma))
        sigma[sigma < low] = np.nan
        logarithmic(axes, low, high)
    axes.plot(run.k, error, color=BLUE, marker="o", markersize=3.5, label="$|g - \\hat g|$")
    axes.plot(run.k, sigma, color=ORANGE, linewidth=1.3, label="its own $\\sigma_g$")
    legend(axes)


def coverage(axes: Axes, run: Record) -> None:
    """Share of a new episode's errors within the nominal 90 %."""
    label(axes, "Coverage of the dynamics", "errors within the\nnominal 90 % width")
    covered = run.series("coverage")
    if not np.isfinite(covered).any():
        say_nothing_known(axes, "known from the first search on")
        return
    axes.axhline(NOMINAL, color=GREY, linewidth=1, linestyle=(0, (4, 3)))
    axes.plot(run.k, covered, color=BLUE, marker="o", markersize=3.5)
    axes.set_ylim(0, 1.04)
    axes.set_yticks([0, 0.25, 0.5, 0.75, NOMINAL, 1.0], ["0", "25 %", "50 %", "75 %", "90 %", ""])


def widths(axes: Axes, run: Record) -> None:
    """β that would have covered 90 % of the errors beyond the noise, and κ, by which it is used."""
    label(axes, "Width of the dynamics' confidence set", "in units of $\\sigma$")
    beta, kappa = run.series("beta"), run.series("kappa")
    if not np.isfinite(beta).any():
        say_nothing_known(axes, "known from the first search on")
        return
    axes.plot(run.k, beta, color=BLUE, marker="o", markersize=3.5, label="β, mean over the state")
    axes.plot(run.k, kappa, color=ORANGE, linewidth=1.3, label="κ, multiplies β")
    stretch(axes, beta)
    legend(axes)


def surprise(axes: Axes, run: Record) -> None:
    """|g - ĝ| / σ_g of each answer, and α, within which 90 % of them were."""
    label(axes, "Calibration of the reward", "$|g - \\hat g| \\,/\\, \\sigma_g$")
    z, alpha = run.surprise, run.series("alpha")
    if not np.isfinite(z).any():
        say_nothing_known(axes, NO_NUMBERS)
        return
    axes.plot(run.k, z, **DOT, color=BLUE, markersize=4.5, label="each answer")
    axes.plot(run.k, alpha, color=ORANGE, linewidth=1.3, drawstyle="steps-post", label="α: 90 % are within")
    axes.axhline(1, color=GREY, linewidth=1, linestyle=(0, (4, 3)))
    stretch(axes, np.maximum(z, 1e-2), alpha)
    legend(axes)


def imagination(axes: Axes, run: Record) -> None:
    """What a search believed that its policy would be worth, and what it was, both by r̂."""
    label(axes, "What was promised, what was done", "return by $\\hat r$\nover a trial's steps")
    k, imagined, executed = run.k, run.series("imagined"), run.series("executed")
    if not np.isfinite(executed).any():
        say_nothing_known(axes, "known from the first search on")
        return
    worst = run.series("imagined_worst")
    axes.plot(k, imagined, color=ORANGE, linewidth=1.6, label="imagined (to worst)")
    axes.fill_between(k, worst, imagined, color=ORANGE, alpha=0.22, linewidth=0)
    axes.plot(k, executed, color=BLUE, marker="o", markersize=3.5, label="executed")
    broken = run.series("overpromised") == 1
    if broken.any():
        axes.plot(k[broken], executed[broken], **DOT, markersize=6.5, color=RED, label="far off")
    legend(axes)


def rollout(axes: Axes, run: Record) -> None:
    """Distance between the model's state and the true one, h steps after they were the same."""
    label(axes, "Error after h steps in the model", "mean $\\|s_{t+h} - \\hat s_{t+h}\\|$\nin units of the state")
    shown = horizons(run)
    if not shown:
        say_nothing_known(axes, "known from the first search on")
        return
    for h, colour in zip(shown, (BLUES * len(shown))[: len(shown)], strict=True):
        error = run.series(h, within="rollout_errors")
        axes.plot(run.k, error, color=colour, linewidth=1.6, marker="o", markersize=2.5, label=f"h = {h}")
    all_errors = np.concatenate([run.series(h, within="rollout_errors") for h in shown])
    all_errors = all_errors[np.isfinite(all_errors) & (all_errors > 0)]
    if len(all_errors):
        logarithmic(axes, all_errors.min() / 1.5, all_errors.max() * 1.5)
    legend(axes)


OVERVIEW: tuple[Panel, ...] = (learning, imagination, preference, transition, rollout, coverage)
PICTURES: Mapping[str, tuple[Panel, ...]] = {
    "learning": (learning,),
    "transition-deviation": (transition,),
    "preference-deviation": (preference,),
    "calibration": (coverage, widths, surprise),
    "imagination": (imagination,),
    "rollout-error": (rollout,),
}
