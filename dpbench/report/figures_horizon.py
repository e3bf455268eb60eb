"""The figure of the horizon sweep: step time against the number of moves, logarithmic on both."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullLocator

from dpbench.analysis.times.horizon_sweep import Sweep, SweptConfiguration, moves_of
from dpbench.report.labels import name_ends
from dpbench.report.style import (
    GREY,
    colour_of,
    family_colours,
    log_time_y,
    new_figure,
)
from dpbench.scenario.horizons import Horizons

ROOM = 1.9
"""So many times the largest n fits on the axis, for the names at the ends of the lines."""


def growth_figure(sweep: Sweep, configurations: Sequence[SweptConfiguration]) -> Figure:
    """Median step time of the configurations against n, a panel per formulation with axes in
    common."""
    forms = list(
        dict.fromkeys(configuration.configuration.formulation for configuration in configurations)
    )
    figure = new_figure(8.2, 1.0 + 5.0 * len(forms))
    panels = figure.subplots(len(forms), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for ax, form in zip(panels, forms, strict=True):
        mine = [
            configuration
            for configuration in configurations
            if configuration.configuration.formulation == form
        ]
        for configuration in mine:
            _line(ax, configuration)
        ax.set_title(form.replace("_", " "))
        ax.set_ylabel("median step time [µs]")
    _axes(panels[-1], sweep.horizons)
    solvers = (each.configuration.solver for each in configurations)
    marks = [
        Line2D([], [], color=colour, marker="o", ms=4.5, label=name)
        for name, colour in family_colours(solvers).items()
    ]
    hollow = Line2D(
        [], [], marker="o", color=GREY, mfc="white", ls="", label="an answer misses the demand"
    )
    figure.legend(handles=[*marks, hollow], loc="outside lower center", ncols=4)
    figure.draw_without_rendering()
    for ax, form in zip(panels, forms, strict=True):
        _names(
            ax,
            [
                configuration
                for configuration in configurations
                if configuration.configuration.formulation == form
            ],
        )
    return figure


def _spots(configuration: SweptConfiguration) -> list[tuple[float, float, bool]]:
    """n, median [µs] and whether the answers are right, the shortest horizons first."""
    found = [(moves_of(h), p.median_ns / 1e3, p.right) for h, p in configuration.timed.items()]
    return sorted(found)


def _line(ax: Axes, configuration: SweptConfiguration) -> None:
    colour, spots = colour_of(configuration.configuration.solver), _spots(configuration)
    ax.plot([n for n, _, _ in spots], [t for _, t, _ in spots], color=colour, lw=1.0, alpha=0.8)
    for n, t, right in spots:
        ax.plot(n, t, "o", color=colour, mfc=colour if right else "white", ms=4.5, zorder=3)


def _axes(ax: Axes, horizons: Sequence[Horizons]) -> None:
    ticks: dict[int, list[str]] = {}
    for N_p, N_c in horizons:
        ticks.setdefault(moves_of((N_p, N_c)), []).append(f"{N_p}/{N_c}")
    ax.set_xscale("log")
    log_time_y(ax)
    ax.xaxis.set_major_locator(FixedLocator(list(ticks)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xticks(list(ticks), ["\n".join([str(n), *names]) for n, names in ticks.items()])
    ax.set_xlim(min(ticks) / 1.15, max(ticks) * ROOM)
    ax.set_xlabel("moves n in a plan, and horizons N_p/N_c")


def _names(ax: Axes, configurations: Sequence[SweptConfiguration]) -> None:
    """The name of each solver right of the end of its line."""
    ends = [
        (
            *_spots(configuration)[-1][:2],
            configuration.configuration.solver,
            colour_of(configuration.configuration.solver),
        )
        for configuration in configurations
        if configuration.timed
    ]
    name_ends(ax, ends)
