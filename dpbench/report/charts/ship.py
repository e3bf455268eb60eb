"""Figures 4-7 of the paper for any scenario, and the steps of several runs, drawn together."""

from collections.abc import Sequence
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.suites.paper import Law
from dpbench.report.charts import style
from dpbench.report.charts.ship_tables import (
    STEP,
    TIME,
    Panel,
    make_error_panels,
    make_force_panels,
    make_increment_panels,
    make_path_tables,
    make_step_panels,
)
from dpbench.scenario.scenario import Scenario

_WIDTH = 285


def draw_path(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Return a chart of the ship's north-east path by control law, with 1 m circle (Figure 4)."""
    tables = make_path_tables(laws, scenario)
    x, y = (
        alt.X("e:Q", title="east [m]", scale=alt.Scale(domain=tables.ranges["e"], nice=False)),
        alt.Y("n:Q", title="north [m]", scale=alt.Scale(domain=tables.ranges["n"], nice=False)),
    )
    lines = alt.Chart(tables.lines).mark_line(strokeWidth=1.8)
    lines = lines.encode(
        x=x, y=y, order=alt.Order("i:Q"), color=_law_colour(laws), strokeDash=_law_dash(laws)
    )
    ring = (
        alt.Chart(tables.circle)
        .mark_line(strokeDash=[3, 3], color=style.SOFT)
        .encode(x=x, y=y, order=alt.Order("i:Q"))
    )
    look = style.names_scale(tables.marks["what"], ("circle", "cross"))
    shape = alt.Shape("what:N", title=None, scale=look, legend=style.legend_below(columns=1))
    marks = alt.Chart(tables.marks).mark_point(filled=True, size=70, color=style.INK)
    marks = marks.encode(x=x, y=y, shape=shape)
    chart = alt.layer(ring, lines, marks, width=285, height=285)
    return style.set_style(chart, "Path of the ship", "Path of the ship under each control law.")


def draw_pose_errors(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Return a chart of position and heading errors over time by control law (Figure 5)."""
    chart = _stack_panels(make_error_panels(laws, scenario), laws)
    wording = "North, east, heading and radial error against time."
    return style.set_style(chart, "Errors of position and heading", wording)


def draw_forces(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Return a chart of the applied force in each axis over time, with its limits (Figure 6)."""
    chart = _stack_panels(make_force_panels(laws, scenario), laws)
    return style.set_style(chart, "Forces", "Force applied in each axis, with its limits.")


def draw_increments(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Return a chart of each axis' change of force a step, with the rate limits (Figure 7)."""
    chart = _stack_panels(make_increment_panels(laws, scenario), laws)
    about = "Change of the force in each step, with its limits."
    return style.set_style(chart, "Increments", about)


def draw_steps_together(runs: Sequence[Law], error_limit: float) -> Any:
    """Return a chart of step time, first move's error and iterations of several runs over steps.

    runs, error_limit : as of `make_step_panels`.
    """
    chart = _stack_panels(make_step_panels(runs, error_limit), runs, over=STEP)
    wording = "Step time, error of the first move and iterations of several runs over their steps."
    return style.set_style(chart, "Step by step", wording)


def draw_signals(panels: Sequence[Panel], laws: Sequence[Law]) -> Any:
    """Return a chart of the outputs and inputs of a plant that is no ship, over time."""
    wording = "Outputs with their references, and inputs, against time."
    return style.set_style(_stack_panels(panels, laws), "Outputs and inputs", wording)


def _stack_panels(panels: Sequence[Panel], laws: Sequence[Law], over: str = TIME) -> Any:
    """Return a chart of panels one below the other, over the same time or steps."""
    drawn = [_draw_panel(panel, laws, over if panel is panels[-1] else "") for panel in panels]
    shared = alt.Resolve(scale=alt.ScaleResolveMap(x="shared"))
    return alt.vconcat(*drawn, spacing=4, resolve=shared)


def _draw_panel(panel: Panel, laws: Sequence[Law], over: str) -> Any:
    """Return a chart of a panel's lines, with its limits or a note; `over` names its x axis."""
    lines = _draw_law_lines(panel, laws, over)
    if panel.limits:
        return alt.layer(lines, _draw_limits(panel.limits))
    if not panel.note:
        return lines
    corner = {"x": alt.value("width"), "y": alt.value(0), "text": alt.value(panel.note)}
    note = alt.MarkDef("text", align="right", baseline="top", color=style.SOFT, fontSize=12)
    return alt.layer(lines, style.inline_chart({}).properties(mark=note).encode(**corner))


def _draw_law_lines(panel: Panel, laws: Sequence[Law], over: str) -> Any:
    """Return a chart of a panel's quantity, a line per control law; `over` names the x axis."""
    scale, axis = style.log_scale() if panel.is_log else alt.Scale(), alt.Axis(tickCount=4)
    title = panel.title.splitlines() if "\n" in panel.title else panel.title
    line = (
        alt.Chart(panel.table)
        .mark_line(strokeWidth=1.3, interpolate="step-after")
        .encode(
            x=alt.X("t:Q", title=over or None, scale=alt.Scale(nice=False)),
            y=alt.Y("value:Q", title=title, scale=scale, axis=axis),
            color=_law_colour(laws),
            strokeDash=_law_dash(laws),
        )
    )
    return line.properties(width=_WIDTH, height=84)


def _draw_limits(values: Sequence[float]) -> Any:
    """Return a chart layer of horizontal dashed rules at the limits of forces over time."""
    chart = alt.Chart(pd.DataFrame({"limit": list(values)}))
    return chart.mark_rule(strokeDash=[5, 3], color=style.SOFT).encode(y=alt.Y("limit:Q"))


def _law_colour(laws: Sequence[Law]) -> alt.Color:
    """Return the colour encoding of a chart's control laws, with a legend."""
    labels = [law.label for law in laws]
    return style.colour("law", labels, style.PALETTE[: len(laws)], labelLimit=0, columns=1)


def _law_dash(laws: Sequence[Law]) -> alt.StrokeDash:
    """Return the dash encoding of a chart's control laws: solid, then dashed."""
    scale = style.names_scale((law.label for law in laws), [[1, 0], [6, 3]][: len(laws)])
    return alt.StrokeDash("law:N", title=None, scale=scale)
