"""The picture of a comparison: learning curves of the arms, with intervals over seeds."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hiprl.report.arms import Arm
from hiprl.report.style import COLOURS, GREY, label, look, new_figure, say_nothing_known

NAME_WIDTH = 26  # letters of a line in the legend


def comparison(arms: Sequence[Arm]) -> Figure:
    """One panel an environment: interquartile mean over seeds and its 95 % interval, by comparisons."""
    envs = list(dict.fromkeys(arm.env for arm in arms))
    with look():
        figure, axes = new_figure(len(envs), 1, width=8.2, height=0.5 + 3.6 * len(envs))
        for env, place in zip(envs, axes.flat, strict=True):
            panel(place, env, [arm for arm in arms if arm.env == env])
    return figure


def panel(axes: Axes, env: str, arms: Sequence[Arm]) -> None:
    """The arms of one environment; the diamonds are the returns of the reported policies."""
    label(axes, env, "true return of the policy\nthat $\\hat r$ ranks best by then")
    last = 0
    for i, arm in enumerate(arms):
        colour, line = COLOURS[i % len(COLOURS)], ("-", "--", ":")[i // len(COLOURS) % 3]
        k, curve = arm.curve()
        if not len(k):
            continue
        last = max(last, int(k[-1]))
        name = "\n".join(textwrap.wrap(f"{arm.name} (n\xa0=\xa0{len(arm.finished or arm.runs)})", NAME_WIDTH))
        axes.plot(k, [point.mean for point in curve], color=colour, linestyle=line, label=name)
        axes.fill_between(
            k, [point.low for point in curve], [point.high for point in curve], color=colour, alpha=0.16, linewidth=0
        )
    if not last:
        say_nothing_known(axes, "no true return is known: the environment pays none,\nor no episode has had a policy")
        return
    for i, arm in enumerate(arms):
        end = arm.final_return()
        if end is not None:
            middle, spread = end.mean, [[end.mean - end.low], [end.high - end.mean]]
            style = {"fmt": "D", "markersize": 5, "capsize": 3, "linewidth": 1.4}
            axes.errorbar([last * (1.03 + 0.025 * i)], [middle], spread, color=COLOURS[i % len(COLOURS)], **style)
    if any(arm.finished for arm in arms):
        axes.plot([], [], linestyle="none", marker="D", markersize=5, color=GREY, label="reported policy")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), labelspacing=0.8)
