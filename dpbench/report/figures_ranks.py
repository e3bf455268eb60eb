"""Figures of rankings: work against precision, and performance profiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dpbench.analysis.demand import Demand
from dpbench.analysis.times.pooled import CommonSteps, PooledTimes
from dpbench.analysis.times.ranks import Ranking, profiles
from dpbench.analysis.times.work_precision import LevelPoint
from dpbench.report.figures import EXACT
from dpbench.report.labels import label_points
from dpbench.report.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    family_of,
    log_time,
    log_y,
    new_figure,
)

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
MARKERS = {"default": "o", "low": "v", "mid": "s", "high": "D"}
OF_EACH = 2
"""So many solvers of each method family are drawn in colour."""
LIGHT = "#B8B8B8"
FARTHEST = 1e3
"""Profiles are drawn up to this ratio: who is slower by more is told by the table."""


def highlighted(solvers: Sequence[str]) -> dict[str, str]:
    """A colour for the first two of each method family; the others are drawn in grey."""
    members: dict[str, list[str]] = {}
    for solver in solvers:
        members.setdefault(family_of(solver), []).append(solver)
    chosen = [s for s in solvers if s in members[family_of(s)][:OF_EACH]]
    return dict(zip(chosen, COLOURS, strict=False))


def work_precision(
    levels_by_solver: Mapping[str, Sequence[LevelPoint]], colours: Mapping[str, str], demand: Demand
) -> Figure:
    """Largest error of the first move against p50 and, where there is one, against p99."""
    panels: list[tuple[str, Callable[[LevelPoint], float]]] = [("p50", lambda point: point.p50_ns)]
    if any(math.isfinite(point.p99_ns) for points in levels_by_solver.values() for point in points):
        panels.append(("p99", lambda point: point.p99_ns))
    figure = new_figure(8.2, 0.6 + 4.9 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    firsts = [
        _panel(ax, levels_by_solver, colours, time)
        for ax, (_, time) in zip(axes, panels, strict=True)
    ]
    for ax, (name, _) in zip(axes, panels, strict=True):
        ax.axhline(demand.error_move, color=INK, ls="--", lw=0.9)
        log_time(ax)
        log_y(ax)
        ax.margins(0.1, 0.07)
        ax.set_xlabel(f"{name} of the algorithmic step time [µs]")
        ax.set_ylabel("largest error of the first move\n[rate-limit steps]")
        ax.tick_params(labelbottom=True)
    figure.legend(handles=_marks(levels_by_solver, demand), loc="outside lower center", ncols=4)
    figure.draw_without_rendering()
    for ax, found in zip(axes, firsts, strict=True):
        shades = [colours.get(solver, GREY) for solver in found]
        label_points(ax, list(found.values()), list(found), shades)
    return figure


def _panel(
    ax: Axes,
    levels_by_solver: Mapping[str, Sequence[LevelPoint]],
    colours: Mapping[str, str],
    time: Callable[[LevelPoint], float],
) -> dict[str, tuple[float, float]]:
    """Draw the levels_by_solver; returns where each is labelled, at its fastest point."""
    firsts: dict[str, tuple[float, float]] = {}
    for solver, points in levels_by_solver.items():
        drawn = [r for r in points if math.isfinite(r.error_move) and math.isfinite(time(r))]
        spots = {r.configuration.settings: (time(r) / 1e3, max(r.error_move, EXACT)) for r in drawn}
        if not spots:
            continue
        colour, order = colours.get(solver, LIGHT), 3 if solver in colours else 2
        line = sorted(spots.values(), key=lambda spot: -spot[1])
        width = 1.6 if solver in colours else 0.8
        ax.plot(*zip(*line, strict=True), color=colour, lw=width, zorder=order)
        for point in reversed(drawn):  # the usual settings on top, where others do the same
            spot = spots[point.configuration.settings]
            filled = colour if point.configuration.settings == "default" else "white"
            marker = MARKERS.get(point.configuration.settings, "P")
            ax.plot(*spot, marker, color=colour, mfc=filled, ms=5.5, zorder=order + 1)
            if point.failed:
                ax.plot(*spot, "x", color=INK, ms=9, mew=1.2, zorder=order + 2)
        firsts[solver] = min(spots.values())
    return firsts


def _marks(levels_by_solver: Mapping[str, Sequence[LevelPoint]], demand: Demand) -> list[Line2D]:
    points = [point for found in levels_by_solver.values() for point in found]
    marks = [
        Line2D(
            [],
            [],
            marker=MARKERS.get(settings, "P"),
            ls="",
            color=GREY,
            mfc=GREY if settings == "default" else "white",
            label=f"settings {settings}",
        )
        for settings in dict.fromkeys(point.configuration.settings for point in points)
    ]
    if any(point.failed for point in points):
        marks.append(Line2D([], [], marker="x", ls="", color=INK, label="steps failed"))
    demanded = f"demand, {demand.error_move:g}"
    return [*marks, Line2D([], [], color=INK, ls="--", lw=0.9, label=demanded)]


def performance_profiles(
    common_steps: CommonSteps, rankings: Sequence[Ranking], colours: Mapping[str, str]
) -> Figure:
    """Share of steps solved within so many times the fastest solver's time, per accuracy."""
    figure = new_figure(8.2, 3.1 * len(rankings))
    axes = figure.subplots(len(rankings), 1, sharex=True, squeeze=False)[:, 0]
    spots = []
    for ax, ranking in zip(axes, rankings, strict=True):
        configurations = [ranked_configuration.pooled for ranked_configuration in ranking.ranked]
        spots.append(_profile_panel(ax, common_steps, configurations, ranking.level, colours))
        ax.set_title(f"error_move ≤ {ranking.level:g}")
        ax.set_ylabel("share of steps")
        ax.set_ylim(-0.03, 1.05)
        log_time(ax)
        ax.tick_params(labelbottom=True)
    axes[-1].set_xlabel("step time, in multiples of the fastest solver's on that step")
    axes[-1].set_xlim(1.0, FARTHEST)
    figure.draw_without_rendering()
    for ax, found in zip(axes, spots, strict=True):
        shades = [colours.get(solver, GREY) for solver in found]
        label_points(ax, list(found.values()), list(found), shades)
    return figure


def _profile_panel(
    ax: Axes,
    common_steps: CommonSteps,
    configurations: Sequence[PooledTimes],
    level: float,
    colours: Mapping[str, str],
) -> dict[str, tuple[float, float]]:
    """Draw the profiles; returns where each is labelled, half way up."""
    spots: dict[str, tuple[float, float]] = {}
    for configuration, (ratio, share) in zip(
        configurations, profiles(common_steps, configurations, level), strict=True
    ):
        colour, bold = (
            colours.get(configuration.configuration.solver, LIGHT),
            configuration.configuration.solver in colours,
        )
        x = np.concatenate(([1.0], ratio, [max(FARTHEST, float(ratio[-1]))]))
        y = np.concatenate(([0.0], share, share[-1:]))
        width = 1.6 if bold else 0.9
        ax.plot(x, y, color=colour, lw=width, drawstyle="steps-post", zorder=3 if bold else 2)
        half = int(np.searchsorted(share, 0.5 * share[-1]))
        if ratio[half] <= FARTHEST:
            spots[configuration.configuration.solver] = (float(ratio[half]), float(share[half]))
    return spots
