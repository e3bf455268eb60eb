"""Figures for print by Matplotlib, of the tables that the page's figures are drawn from."""

import io
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from dpbench.analysis.verdict.requirements import STATES
from dpbench.bench.record.schema import FORCES
from dpbench.report.charts import style
from dpbench.report.charts.overview import FULL, VERDICT_FILLS, shorten_settings
from dpbench.report.charts.ship_tables import STEP, TIME, Panel, PathTables

COLUMN_IN = 3.5
"""Width of a figure in one column of a two-column paper [inch]."""
FEW_DECADES = 1.5
"""Decades below which a logarithmic axis has labels between powers of ten."""
_DASHES = ("-", "--", "-.", ":")
_SMALL: dict[str, Any] = {"fontsize": 7}
_LIMIT: dict[str, Any] = {"color": style.FAIL, "linestyle": "--", "linewidth": 0.8}
_MARKERS = dict(zip(STATES, ("o", "^", "D", ">", "X", "s"), strict=True))
"""The shapes of `STATE_SHAPES`."""
_SETTINGS_MARKERS = "osPD^v><"
"""The shapes that Vega gives to the settings, in alphabetical order."""
_COLOURS = dict(zip(STATES, style.STATE_COLOURS, strict=True))


class PrintedFigure(Figure):
    """A figure that a notebook shows without pyplot, which would show it twice."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Save the figure; in PDF with TrueType fonts, as many publishers refuse Type 3."""
        with rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        """Return the figure as PNG."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=120)
        return buffer.getvalue()


def draw_path(tables: PathTables) -> Figure:
    """Return a Matplotlib figure of the ship's north-east path by control law (Figure 4)."""
    figure, (axes,) = _make_axes([COLUMN_IN])
    axes.plot(tables.circle["e"], tables.circle["n"], ":", color=style.SOFT, linewidth=0.8)
    _draw_laws(axes, tables.lines, "e", "n")
    for marker, mark in zip("ox", tables.marks.to_dict("records"), strict=True):
        axes.plot(mark["e"], mark["n"], marker, color=style.INK, markersize=4, label=mark["what"])
    limits = tables.ranges
    axes.set(xlabel="east [m]", ylabel="north [m]", xlim=limits["e"], ylim=limits["n"])
    axes.set_aspect("equal")
    return _add_legend(figure, axes)


def draw_panels(panels: Sequence[Panel], over: str = TIME) -> Figure:
    """Return a Matplotlib figure of panels, one below the other, over one time axis or steps."""
    figure, rows = _make_axes([1.1] * len(panels), sharex=True)
    for axes, panel in zip(rows, panels, strict=True):
        _draw_laws(axes, panel.table, "t", "value", drawstyle="steps-post")
        for limit in panel.limits:
            axes.axhline(limit, color=style.SOFT, linestyle="--", linewidth=0.8)
        axes.set(ylabel=panel.title, yscale="log" if panel.is_log else "linear")
        if panel.is_log:
            _label_log_axis(axes.yaxis)
        axes.annotate(
            panel.note, (0.98, 0.95), xycoords="axes fraction", ha="right", va="top", **_SMALL
        )
    rows[-1].set(xlabel=over)
    return _add_legend(figure, rows[0])


def draw_step_strips(
    table: pd.DataFrame, forces: pd.DataFrame | None, error_limit: float
) -> Figure:
    """Return a Matplotlib figure of a run's solve time, error, iterations and forces over steps.

    table, forces, error_limit : as of `charts.steps.draw_step_strips`.
    """
    figure, rows = _make_axes([1.2, 1.2, 1.0] + ([] if forces is None else [1.0]), sharex=True)
    times, errors, iterations = rows[:3]
    dots: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 3}
    times.vlines(table["k"], table["time_us"], table["raw_us"], color=style.LINE, linewidth=0.8)
    times.plot(table["k"], table["time_us"], color=style.ACCENT, **dots)
    times.set(ylabel="time [µs]", yscale="log")
    for failed, colour in ((False, style.SOFT), (True, style.FAIL)):
        some = table[table["failed"].astype(bool) == failed]
        errors.plot(some["k"], some["error"].clip(lower=style.FLOOR), color=colour, **dots)
    errors.axhline(error_limit, **_LIMIT)
    errors.set(ylabel="error of the\nfirst move", yscale="log")
    for axes in (times, errors):
        _label_log_axis(axes.yaxis)
    iterations.fill_between(table["k"], table["active"], step="post", color=style.LINE)
    iterations.plot(table["k"], table["iterations"], color=style.INK, **dots)
    iterations.set(ylabel="iterations, active")
    if forces is not None:
        for force, colour in zip(FORCES, style.PALETTE, strict=False):
            own = forces[forces["force"] == force]
            line: dict[str, Any] = {"color": colour, "drawstyle": "steps-post", "linewidth": 1.0}
            rows[3].plot(own["k"], own["share"], label=force, **line)
        rows[3].set(ylabel="force or\nmoment / limit", ylim=(-1.05, 1.05))
        _add_legend(figure, rows[3])
    rows[-1].set(xlabel=STEP)
    return figure


def draw_deadline_chart(table: pd.DataFrame, deadline_ms: float, p99_ms: float) -> Figure:
    """Return a Matplotlib figure of all solvers' step times (p50 to largest) and the deadline.

    table, p99_ms : as of `charts.overview.draw_deadline_chart`.
    """
    figure, (axes,) = _make_axes([0.8 + 0.22 * len(table)], width=2 * COLUMN_IN)
    for place, row in enumerate(table.to_dict("records")):
        colour, p99_end = _COLOURS[row["verdict"]], np.fmax(row["p50_ms"], row["limiting_p99_ms"])
        axes.hlines(place, row["max_ms"], row["longest_ms"], color=style.SOFT, linestyle=":")
        axes.hlines(place, row["p50_ms"], row["max_ms"], color=colour, linewidth=1.5)
        axes.hlines(place, row["p50_ms"], p99_end, color=colour, linewidth=6)
        axes.plot(row["p50_ms"], place, _MARKERS[row["verdict"]], color=colour, markersize=6)
    limits = (p99_ms, "p99 limit", "--"), (deadline_ms, "deadline", "-")
    for at_ms, name, line in limits if np.isfinite(deadline_ms) else ():
        axes.axvline(at_ms, color=style.INK, linestyle=line, linewidth=0.8, label=name)
    for state in (state for state in STATES if state in set(table["verdict"])):
        axes.plot([], [], _MARKERS[state], color=_COLOURS[state], label=f"p50, {state}")
    axes.plot([], [], color=style.SOFT, linewidth=6, label="p50 to limiting p99")
    axes.plot([], [], color=style.SOFT, linewidth=1.5, label="to the longest step")
    axes.plot([], [], color=style.SOFT, linestyle=":", label="to the largest single timing")
    axes.set(xscale="log", xlabel="step time [ms]")
    _label_log_axis(axes.xaxis)
    axes.set_yticks(range(len(table)), table["label"], **_SMALL)
    axes.set_ylim(len(table) - 0.5, -0.5)
    return _add_legend(figure, axes)


def draw_accuracy(table: pd.DataFrame, error_limit: float) -> Figure:
    """Return a Matplotlib figure of largest error over median step time, a line per solver.

    Colours are families, shapes settings, and fills verdicts, as of `FULL`.
    table, error_limit : as of `charts.overview.draw_accuracy`.
    """
    figure, (axes,) = _make_axes([3.6], width=2 * COLUMN_IN)
    levels = sorted(table["settings"].unique())
    markers = {level: _SETTINGS_MARKERS[i % 8] for i, level in enumerate(levels)}
    for solver, own in table.groupby("solver", sort=False):
        colour = style.FAMILY_COLOURS[own["family"].iloc[0]]
        errors = own["error"].clip(lower=style.FLOOR)
        axes.plot(own["p50_us"], errors, color=colour, linewidth=0.8, alpha=0.5)
        for row, error in zip(own.to_dict("records"), errors, strict=True):
            look: dict[str, Any] = {
                "facecolors": _mix_with_paper(colour, row["verdict"]),
                "edgecolors": colour,
            }
            axes.scatter(
                row["p50_us"], error, 22, marker=markers[row["settings"]], zorder=3, **look
            )
        best = errors.argmin()
        corner = (own["p50_us"].iloc[best], errors.iloc[best])
        axes.annotate(str(solver), corner, (3, 3), textcoords="offset points", **_SMALL)
    _draw_accuracy_legend(axes, set(table["family"]), markers)
    axes.axhline(error_limit, **_LIMIT)
    ylabel = "largest error of the first move in the replays\n[maximum increments]"
    axes.set(xscale="log", yscale="log", xlabel="p50 of the step time [µs]", ylabel=ylabel)
    for axis in (axes.xaxis, axes.yaxis):
        _label_log_axis(axis)
    return _add_legend(figure, axes)


def _mix_with_paper(colour: str, state: str) -> list[float]:
    """Return the fill of a point, opaque above its line, by family colour and verdict."""
    share = FULL.get(state, FULL["inconclusive"])
    return [share * part + 1.0 - share for part in to_rgb(colour)]


def _draw_accuracy_legend(axes: Axes, families: set[str], markers: dict[str, str]) -> None:
    """Add entries of families, settings and verdicts to the legend of given Matplotlib axes."""
    for family in (family for family in style.FAMILY_COLOURS if family in families):
        axes.plot([], [], "o", color=style.FAMILY_COLOURS[family], label=family)
    for level, name in shorten_settings([*markers]).items():
        axes.plot([], [], markers[level], color=style.INK, label=name)
    for states, fill in VERDICT_FILLS.items():
        looks: dict[str, Any] = {"color": style.INK, "markerfacecolor": fill}
        axes.plot([], [], "o", label=f"verdict {states}", **looks)


def _make_axes(
    heights: Sequence[float], *, width: float = COLUMN_IN, sharex: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure of axes one below the other, of these heights and this width [inch]."""
    figure = PrintedFigure(figsize=(width, 0.5 + sum(heights)), layout="constrained")
    axes = figure.subplots(
        len(heights), sharex=sharex, squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    rows: list[Axes] = list(axes[:, 0])
    for one in rows:
        one.grid(color=style.GRID, linewidth=0.6)
        one.set_axisbelow(True)
        one.tick_params(labelsize=7, which="both")
        one.xaxis.label.set_fontsize(8)
        one.yaxis.label.set_fontsize(8)
        one.spines[["top", "right"]].set_visible(False)
    figure.align_ylabels(rows)
    return figure, rows


def _label_log_axis(axis: Axis) -> None:
    """Label 2 and 5 between the powers of ten of an axis that spans few of them, else none."""

    def label(value: float, _: int | None = None) -> str:
        low, high = np.log10(axis.get_view_interval())
        return f"{value:.3g}" if high - low < FEW_DECADES else ""

    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_minor_formatter(FuncFormatter(label))


def _draw_laws(axes: Axes, table: pd.DataFrame, x: str, y: str, **look: Any) -> None:
    """Draw y over x into given Matplotlib axes, a line for each control law."""
    for i, (law, own) in enumerate(table.groupby("law", sort=False)):
        colour, dash = style.PALETTE[i % len(style.PALETTE)], _DASHES[i % len(_DASHES)]
        axes.plot(own[x], own[y], dash, color=colour, linewidth=1.0, label=str(law), **look)


def _add_legend(figure: Figure, axes: Axes) -> Figure:
    """Add a legend below a figure, of what has a label in these axes; return the figure."""
    handles, labels = axes.get_legend_handles_labels()
    room = 18.0 * figure.get_figwidth()  # letters in a row
    labels = [textwrap.fill(label, int(room) - 8) for label in labels]
    columns = max(1, min(len(labels), int(room / (8 + max(map(len, labels))))))
    options: dict[str, Any] = {"loc": "outside lower center", "frameon": False}
    figure.legend(handles, labels, ncols=columns, **options, **_SMALL)
    return figure
