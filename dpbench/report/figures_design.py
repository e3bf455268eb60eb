"""Figures on the design of controllers: eigenvalues of the loop, regions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from dpbench.bench.design.design_file import DesignRecord
from dpbench.report.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    VERMILLION,
    new_figure,
    one_axes,
)
from dpbench.report.tables_design import names_of, region_in, region_text, weathers

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
MARKERS = ("o", "s", "D", "^", "v", "P")
DECAYS = (2, 3, 5, 10, 20, 50)
"""Time constants [samples] of the arcs of equal decay."""
HEIGHT = 0.8
"""Of the bars of one vessel together, in rows."""
ALPHAS = (1.0, 0.45)
"""Of the first weather and of the others."""


def eigenvalues(records: Sequence[DesignRecord]) -> Figure:
    """Roots of the unconstrained loop, upper half plane, one panel a controller."""
    names = names_of(records)
    vessels = list(dict.fromkeys(r.vessel for r in records))
    roots = np.array([root for r in records for root in r.eigenvalues])
    left, high = roots[:, 0].min(), np.abs(roots[:, 1]).max()
    left, right = left - 0.04 * (1.0 - left), max(1.0, roots[:, 0].max()) + 0.012
    low, high = -0.06 * high, max(1.2 * high, 0.05)
    width = 8.2
    tall = 0.9 + min(4.0, (width - 0.8) * (high - low) / (right - left))
    figure = new_figure(width, 0.5 + tall * len(names))
    panels = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for ax, (controller, name) in zip(panels, names.items(), strict=True):
        ax.set_xlim(left, right)
        ax.set_ylim(low, high)
        ax.set_aspect("equal")
        _arcs(ax, left, high)
        for r in records:
            if r.controller == controller:
                _roots(ax, r, vessels.index(r.vessel))
        ax.set_title(name)
        ax.set_ylabel("imaginary part")
        ax.grid(visible=False)
    panels[-1].set_xlabel("real part")
    marks = [
        Line2D([], [], marker=_of(MARKERS, i), ls="", color=_of(COLOURS, i), mfc="none", label=name)
        for i, name in enumerate(vessels)
    ]
    circle = Line2D([], [], color=INK, lw=1.2, label="unit circle")
    figure.legend(handles=[*marks, circle], loc="outside lower center", ncols=6)
    return figure


def _of(choices: Sequence[str], i: int) -> str:
    return choices[i % len(choices)]


def _roots(ax: Axes, record: DesignRecord, i: int) -> None:
    upper = np.array([root for root in record.eigenvalues if root[1] >= 0.0])
    ax.plot(
        upper[:, 0],
        upper[:, 1],
        _of(MARKERS, i),
        color=_of(COLOURS, i),
        mfc="none",
        mew=1.3,
        ms=6.5,
        zorder=3,
        clip_on=False,
    )


def _arcs(ax: Axes, left: float, high: float) -> None:
    """The unit circle and, inside it, the arcs of equal decay with their labels."""
    angle = np.linspace(0.0, math.pi, 800)
    x, y = np.cos(angle), np.sin(angle)
    ax.axhline(0.0, color=PALE, lw=0.8, zorder=0)
    ax.fill_between([1.0, 2.0], -1.0, 2.0, color=PALE, alpha=0.35, lw=0, zorder=0)
    ax.fill_between(x, y, 2.0, color=PALE, alpha=0.35, lw=0, zorder=0)
    ax.plot(x, y, color=INK, lw=1.2, zorder=1)
    for samples in DECAYS:
        radius = math.exp(-1.0 / samples)
        ax.plot(radius * x, radius * y, color=PALE, lw=1.0, zorder=0)
        top = 0.93 * high
        across = math.sqrt(max(radius**2 - top**2, 0.0))
        if across > left:
            ax.text(
                across,
                top,
                f"{samples} samples" if samples == DECAYS[-3] else f"{samples}",
                fontsize=7,
                color=GREY,
                ha="center",
                va="center",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )


def regions(records: Sequence[DesignRecord]) -> Figure:
    """The largest sway offset held, at full size, by vessel, controller and weather."""
    names = names_of(records)
    vessels = list(dict.fromkeys(r.vessel for r in records))
    seas = weathers(records)
    slots = len(names) * len(seas)
    figure, ax = one_axes(8.2, 1.3 + (0.17 * slots + 0.12) * len(vessels))
    tried = [
        t.offset_m * r.model_scale for r in records for b in r.regions for t in b.bracket.tried
    ]
    left, right = 0.7 * min(tried), max(tried)
    for r in records:
        for j, sea in enumerate(seas):
            i = list(names).index(r.controller)
            slot = i * len(seas) + j
            y = vessels.index(r.vessel) + (slot - 0.5 * (slots - 1)) * HEIGHT / slots
            found = region_in(r, sea)
            if found is None:
                continue
            held = max(found.bracket.holds_m * r.model_scale, left)
            ax.barh(
                y,
                held - left,
                left=left,
                height=0.86 * HEIGHT / slots,
                color=_of(COLOURS, i),
                alpha=ALPHAS[j > 0],
                lw=0,
            )
            ax.text(
                1.04 * held, y, f"{region_text(r, found)} m", va="center", fontsize=7, color=INK
            )
    ax.set_xscale("log")
    ax.set_xlim(left, 2.2 * right)
    ax.xaxis.set_major_locator(LogLocator(base=2.0, numticks=20))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_yticks(range(len(vessels)), vessels)
    ax.set_ylim(len(vessels) - 0.45, -0.55)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("largest sway offset held, at full size [m]")
    marks = [
        Patch(color=_of(COLOURS, i), alpha=ALPHAS[j > 0], label=f"{name}, {sea}")
        for i, name in enumerate(names.values())
        for j, sea in enumerate(seas)
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=2 if len(marks) > 3 else 3)
    return figure
