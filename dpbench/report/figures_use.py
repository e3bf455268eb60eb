"""The figure of the step down from the wrapper to a warm start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dpbench.analysis.times.routes import (
    KEPT,
    LEVELS,
    NATIVE,
    WARM,
    WRAPPED,
    RouteComparison,
    RoutePolicy,
    route_policy_text,
)
from dpbench.report.style import BLUE, GREY, PALE, SKY, VERMILLION, log_time, one_axes

COLOURS: dict[RoutePolicy, str] = {WRAPPED: GREY, NATIVE: SKY, KEPT: BLUE, WARM: VERMILLION}
MARKERS: dict[RoutePolicy, str] = {WRAPPED: "s", NATIVE: "o", KEPT: "D", WARM: "v"}
STEP = 0.2
"""How far one way stands below the one before it, in rows."""


def step_down(ways: Sequence[RouteComparison], right: Sequence[frozenset[RoutePolicy]]) -> Figure:
    """Per solver a stair of p50 with a whisker to p95; hollow where answers miss the demand."""
    figure, ax = one_axes(8.2, 1.5 + 0.46 * len(ways))
    for i, (w, good) in enumerate(zip(ways, right, strict=True)):
        ax.axhspan(i - 0.5, i + 0.5, color=PALE, alpha=0.25 * (i % 2), lw=0)
        stairs = []
        for j, way in enumerate(LEVELS):
            if way not in w.times:
                continue
            y = i + STEP * (j - 1.5)
            middle, high = np.percentile(w.times[way].algo_ns, (50, 95)) / 1e3
            ax.plot([middle, high], [y, y], color=COLOURS[way], lw=1.2, zorder=2)
            face = COLOURS[way] if way in good else "white"
            ax.plot(middle, y, MARKERS[way], color=COLOURS[way], mfc=face, ms=5.5, zorder=3)
            stairs.append((middle, y))
        ax.plot(*np.transpose(stairs), color=GREY, lw=0.7, zorder=1)
    log_time(ax)
    ax.set_yticks(range(len(ways)), [w.solver for w in ways])
    ax.set_ylim(len(ways) - 0.45, -0.55)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("algorithmic step time, p50 with a whisker to p95 [µs]")
    marks = [
        Line2D(
            [], [], marker=MARKERS[way], color=COLOURS[way], lw=1.2, label=route_policy_text(way)
        )
        for way in LEVELS
        if any(way in w.times for w in ways)
    ]
    hollow = Line2D(
        [], [], marker="o", color=GREY, mfc="white", ls="", label="an answer misses the demand"
    )
    figure.legend(handles=[*marks, hollow], loc="outside lower center", ncols=3)
    return figure
