"""Figures of the benchmark: step times, error against time, units, deviation of the loops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter

from dpbench.analysis.demand import Demand
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.judge.rules import percentile
from dpbench.report.formats import count_text, error_text, plural, share_text
from dpbench.report.style import (
    GREY,
    INK,
    PALE,
    colour_of,
    family_colours,
    log_time,
    log_x,
    new_figure,
    one_axes,
    power_label,
)
from dpbench.report.tables_accuracy import UnitsCell, UnitsMatrix
from dpbench.report.tables_timing import PooledConfiguration

EXACT = 1e-15
"""Errors below it are drawn at it: the optimum itself is not known better."""


def step_times(configurations: Sequence[PooledConfiguration], demand: Demand) -> Figure:
    """Step times per configuration: algorithmic in colour, raw samples in grey, of medians a
    tick."""
    figure, ax = one_axes(8.2, 1.4 + 0.3 * len(configurations))
    for i, (row, times) in enumerate(configurations):
        colour = colour_of(row.solver)
        raw, algo = times.raw_ns / 1e3, times.algo_ns / 1e3
        low, middle, high = (percentile(algo, percent) for percent in (5, 50, 95))
        ax.plot([raw.min(), raw.max()], [i, i], color=PALE, lw=5, solid_capstyle="butt", zorder=1)
        ax.plot([low, high], [i, i], color=colour, lw=5, solid_capstyle="butt", alpha=0.75)
        ax.plot([algo.min(), algo.max()], [i, i], color=colour, lw=1)
        ax.plot(middle, i, "o", color="white", mec=colour, ms=5, zorder=4)
        ax.plot(percentile(times.typical_ns, 95) / 1e3, i, "|", color=INK, ms=9, zorder=5)
        ax.plot(percentile(raw, 99), i, "d", color=GREY, ms=3.5, zorder=5)
    ax.axvline(demand.p99_ms * 1e3, color=INK, ls="--", lw=0.9)
    log_time(ax)
    ax.set_yticks(range(len(configurations)), [row.name for row, _ in configurations])
    ax.set_ylim(len(configurations) - 0.4, -0.6)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("step time [µs]")
    marks = [
        Line2D([], [], marker="o", color=GREY, mfc="white", lw=5, label="algorithmic p5-p50-p95"),
        Line2D([], [], color=GREY, lw=1, label="algorithmic min-max"),
        Line2D([], [], marker="|", color=INK, ls="", ms=9, label="median over rounds, p95"),
        Line2D([], [], color=PALE, lw=5, label="raw samples min-max"),
        Line2D([], [], marker="d", color=GREY, ls="", ms=3.5, label="raw samples p99"),
        Line2D([], [], color=INK, ls="--", lw=0.9, label=f"demand, {demand.p99_ms:g} ms"),
    ]
    _legend(figure, [*marks, *_family_patches([row.solver for row, _ in configurations])])
    return figure


def _family_patches(solvers: Sequence[str]) -> list[Patch]:
    colours = family_colours(solver.partition(" (")[0] for solver in solvers)
    return [Patch(color=colour, label=name) for name, colour in colours.items()]


def _legend(figure: Figure, handles: Sequence[Line2D | Patch]) -> None:
    figure.legend(handles=list(handles), loc="outside lower center", ncols=4)


def units_heat_map(matrix: UnitsMatrix) -> Figure:
    """Largest error of the first move per solver and configuration, with the share of true
    answers."""
    columns, solvers = matrix.columns, matrix.solvers
    # Below this height the label of the colour bar is longer than the bar's axis.
    height = max(4.6, 1.8 + 0.3 * len(solvers))
    figure, ax = one_axes(2.0 + 0.95 * len(columns), height)
    error = np.full((len(solvers), len(columns)), np.nan)
    for i, solver in enumerate(solvers):
        for j, column in enumerate(columns):
            cell = matrix.cells.get((solver, column))
            if cell is None or cell.steps == 0:
                label = "not run" if cell is None else "no step done"
                ax.text(j, i, label, ha="center", va="center", fontsize=7, color=GREY)
                continue
            if cell.steps < cell.asked:
                ax.add_patch(
                    Rectangle((j - 0.5, i - 0.5), 1, 1, fc=PALE, ec="white", hatch="///", lw=0)
                )
                ax.text(j, i, _cut(cell), ha="center", va="center", fontsize=6.5, color=INK)
                continue
            found = 10.0 if math.isinf(cell.error_move) else cell.error_move
            error[i, j] = np.clip(found, 1e-12, 10.0)
            dark = error[i, j] > 3e-2
            ax.text(
                j,
                i,
                f"{error_text(cell.error_move)}\n{share_text(cell.true_share)}",
                ha="center",
                va="center",
                fontsize=6.5,
                linespacing=0.95,
                color="white" if dark else INK,
            )
    ramp = LinearSegmentedColormap.from_list(
        "error", ["#F3F7FA", "#BBD5E8", "#FDD49E", "#EF6548", "#7F0000"]
    )
    image = ax.imshow(error, aspect="auto", cmap=ramp, norm=LogNorm(1e-12, 10.0))
    ax.set_xticks(range(len(columns)), [f"{s}\n{u}\n{a}" for s, u, a in columns])
    ax.set_yticks(range(len(solvers)), solvers)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    bar = figure.colorbar(image, ax=ax, shrink=0.8, pad=0.02, format=FuncFormatter(power_label))
    bar.set_label("largest error of the first move [rate-limit steps]")
    bar.outline.set_visible(False)
    return figure


def _cut(cell: UnitsCell) -> str:
    """What stands on a cell that did not reach its steps."""
    return f"{error_text(cell.error_move)}\n{count_text(cell.steps)} of {count_text(cell.asked)}"


def deviations(loops: Mapping[str, Sequence[RunRecord]]) -> Figure:
    """Largest deviation of position from the exactly solved loop, per solver and scenario."""
    names = list(dict.fromkeys(row.short_name for rows in loops.values() for row in rows))
    worst = {
        name: max(
            row.dev_position_max_m
            for rows in loops.values()
            for row in rows
            if row.short_name == name
        )
        for name in names
    }
    baseline_law = {r.short_name for rows in loops.values() for r in rows if r.is_baseline_law}
    names.sort(key=lambda name: (name in baseline_law, worst[name]))
    figure = new_figure(8.2, 1.3 + 0.24 * len(names))
    axes = figure.subplots(1, len(loops), sharey=True, sharex=True, squeeze=False)[0]
    for ax, (scenario, rows) in zip(axes, loops.items(), strict=True):
        for row in rows:
            y = names.index(row.short_name)
            value = max(row.dev_position_max_m, EXACT)
            colour = GREY if row.is_baseline_law else colour_of(row.solver)
            ax.barh(y, value, left=0, height=0.62, color=colour, alpha=0.85)
            cut = row.steps_done < row.steps_planned
            if cut:
                ax.text(
                    value,
                    y,
                    f" {plural(row.steps_done, 'step')}",
                    va="center",
                    fontsize=6.5,
                )
        ax.set_title(scenario)
        log_x(ax)
        ax.set_xlim(EXACT / 3, 100)
        ax.set_xlabel("deviation [m]")
        ax.grid(axis="y", visible=False)
    axes[0].set_yticks(
        range(len(names)), [f"{n} (baseline_law)" if n in baseline_law else n for n in names]
    )
    axes[0].set_ylim(len(names) - 0.4, -0.6)
    _legend(figure, _family_patches([n for n in names if n not in baseline_law]))
    return figure
