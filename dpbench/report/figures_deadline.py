"""The figure of the slow computers: closed-loop cost against slow-down, logarithmic on both."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullLocator

from dpbench.analysis.slowdown import (
    MARGIN,
    DelayedConfiguration,
    DelayedGroup,
    cost_ratio,
    survived,
)
from dpbench.report.labels import name_ends
from dpbench.report.style import (
    GREY,
    INK,
    colour_of,
    family_colours,
    log_y,
    one_axes,
)

ROOM = 0.22
"""So much of the axis is for the names at the ends of the lines."""


def slowdown_figure(group: DelayedGroup) -> Figure:
    """Cost over the exactly solved loop's, a line per configuration; hollow where it did not
    survive."""
    figure, ax = one_axes(8.2, 6.2)
    ax.axhline(1.0 + MARGIN, color=INK, lw=0.8, ls="--")
    for configuration in group.configurations:
        _line(ax, configuration)
    _axes(ax, group)
    solvers = (each.configuration.solver for each in group.configurations)
    marks = [
        Line2D([], [], color=colour, marker="o", ms=4.5, label=name)
        for name, colour in family_colours(solvers).items()
    ]
    beyond = f"beyond {100 * MARGIN:g} %"
    hollow = Line2D([], [], marker="o", color=GREY, mfc="white", ls="", label=beyond)
    margin = Line2D([], [], color=INK, lw=0.8, ls="--", label=f"{100 * MARGIN:g} % over")
    figure.legend(handles=[*marks, hollow, margin], loc="outside lower center", ncols=3)
    figure.draw_without_rendering()
    ends = [
        (
            *_spots(configuration)[-1][:2],
            configuration.name,
            colour_of(configuration.configuration.solver),
        )
        for configuration in _drawn(group)
    ]
    name_ends(ax, ends)
    return figure


def _spots(configuration: DelayedConfiguration) -> list[tuple[float, float, bool]]:
    """Slow-down, cost ratio, and whether the loop survived; only loops run to their end."""
    found = [(s, cost_ratio(row), survived(row)) for s, row in configuration.loops.items()]
    return [spot for spot in found if math.isfinite(spot[1]) and spot[1] > 0.0]


def _drawn(group: DelayedGroup) -> list[DelayedConfiguration]:
    return [configuration for configuration in group.configurations if _spots(configuration)]


def _line(ax: Axes, configuration: DelayedConfiguration) -> None:
    colour, spots = colour_of(configuration.configuration.solver), _spots(configuration)
    ax.plot([s for s, _, _ in spots], [c for _, c, _ in spots], color=colour, lw=1.0, alpha=0.7)
    for slowdown, cost, good in spots:
        ax.plot(slowdown, cost, "o", color=colour, mfc=colour if good else "white", ms=4.5)


def _axes(ax: Axes, group: DelayedGroup) -> None:
    slowdowns = group.slowdowns
    ax.set_xscale("log")
    log_y(ax)
    ax.xaxis.set_major_locator(FixedLocator(slowdowns))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xticks(slowdowns, [f"{slowdown:g}" for slowdown in slowdowns])
    span = max(math.log10(slowdowns[-1] / slowdowns[0]), 1.0)
    ax.set_xlim(slowdowns[0] / 10 ** (0.03 * span), slowdowns[-1] * 10 ** (ROOM * span))
    ax.set_xlabel("slow-down of the computer")
    ax.set_ylabel("closed-loop cost over the exactly solved loop's")
