"""Figures 4-7 of the paper for any scenario: path, errors, forces and increments of its laws."""

from collections.abc import Sequence
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from dpbench.analysis.records.thinned_runs import MOST, extreme_indices
from dpbench.analysis.suites.paper import CIRCLE_M, Law, pose_errors
from dpbench.arrays import Vector
from dpbench.report.charts import style
from dpbench.scenario.scenario import Scenario

CORNERS = 73
"""Corners of the polygon of a circle: every 5°, the first again at the end."""
DRAWN_FORCES = (
    ("surge", "x", "N", 1e3, "kN"),
    ("sway", "y", "N", 1e3, "kN"),
    ("yaw", "n", "Nm", 1e6, "MN·m"),
)
_WIDTH = 285
MOST_TOGETHER = 4800
"""Points of all runs in a figure: a notebook refuses tables of more than 5000 rows."""


def draw_path(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Draw the ship's north-east path under each control law, with the 1 m circle (Figure 4)."""
    tables = []
    for law in laws:
        thin = law.steps.iloc[:: len(law.steps) // _points_per_run(laws) + 1]
        places = {"i": range(len(thin)), "n": thin["n_m"], "e": thin["e_m"]}
        tables.append(pd.DataFrame({"law": law.label, **places}))
    table = pd.concat(tables)
    north, east = (float(x) for x in scenario.reference[:2])
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS)
    n, e = north + CIRCLE_M * np.cos(angle), east + CIRCLE_M * np.sin(angle)
    circle = pd.DataFrame({"i": range(CORNERS), "n": n, "e": e})
    starts = [*map(float, scenario.start[:2])]
    kinds = ["start", "reference"]
    points = pd.DataFrame([starts, [north, east]], columns=["n", "e"]).assign(what=kinds)
    x, y = _equal_axes(pd.concat([table, circle, points]))
    lines = alt.Chart(table).mark_line(strokeWidth=1.8)
    lines = lines.encode(x=x, y=y, order="i:Q", color=_law_colour(laws), strokeDash=_law_dash(laws))
    ring = (
        alt.Chart(circle)
        .mark_line(strokeDash=[3, 3], color=style.SOFT)
        .encode(x=x, y=y, order="i:Q")
    )
    look = style.names_scale(kinds, ("circle", "cross"))
    shape = alt.Shape("what:N", title=None, scale=look, legend=style.legend_below(columns=1))
    marks = alt.Chart(points).mark_point(filled=True, size=70, color=style.INK)
    marks = marks.encode(x=x, y=y, shape=shape)
    chart = alt.layer(ring, lines, marks, width=285, height=285)
    return style.set_style(chart, "Path of the ship", "Path of the ship under each control law.")


def draw_pose_errors(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Draw north, east, heading and radial error over time under each control law (Figure 5)."""
    panels = []
    for name, unit in (("north", "m"), ("east", "m"), ("heading", "°"), ("radial", "m")):
        table = _law_time_series(
            laws, lambda law, name=name: pose_errors(law.steps, scenario.reference)[name]
        )
        log = name == "radial"
        if log:
            # A zero has no place on a log axis; a micrometre is below anything of interest.
            table["value"] = table["value"].clip(lower=1e-6)
        panel = _draw_law_lines(table, laws, f"{name} [{unit}]", last=log, log=log)
        if log:
            panel = alt.layer(panel, _draw_limits((CIRCLE_M,)))
        panels.append(panel)
    wording = "North, east, heading and radial error against time."
    return style.set_style(_stack_panels(panels), "Errors of position and heading", wording)


def draw_forces(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Draw the applied force in each axis over time, with its limits (Figure 6)."""
    panels = _draw_axes(laws, "tau", "", scenario.vessel.tau_min, scenario.vessel.tau_max)
    return style.set_style(panels, "Forces", "Force applied in each axis, with its limits.")


def draw_increments(laws: Sequence[Law], scenario: Scenario) -> Any:
    """Draw the change of force in each step over time, with the rate limits (Figure 7)."""
    most = scenario.force_step_max
    panels = _draw_axes(laws, "dtau", "Δ", -most, most)
    about = "Change of the force in each step, with its limits."
    return style.set_style(panels, "Increments", about)


def _draw_axes(laws: Sequence[Law], column: str, sign: str, low: Vector, high: Vector) -> Any:
    """Draw force or force change over time for each axis, with limits (3,) or a note on them."""
    panels = []
    for (name, key, unit, scale, shown), *limits in zip(DRAWN_FORCES, low, high, strict=True):
        title, field = f"{sign}{name} [{shown}]", f"{column}_{key}_{unit}"
        table = _law_time_series(laws, lambda law, f=field, s=scale: law.steps[f].to_numpy() / s)
        reach = float(np.abs(table["value"]).max())
        near = [limit / scale for limit in limits if abs(limit / scale) <= 2.5 * max(reach, 1e-12)]
        # Limits far off are said, as a figure without them looks as if there were none.
        far = f"limits ±{max(map(abs, limits)) / scale:.4g}"
        corner = {"x": alt.value("width"), "y": alt.value(0), "text": alt.value(far)}
        note = alt.MarkDef("text", align="right", baseline="top", color=style.SOFT, fontSize=12)
        words = style.inline_chart({}).properties(mark=note).encode(**corner)
        lines = _draw_law_lines(table, laws, title, last=name == "yaw")
        panels.append(alt.layer(lines, _draw_limits(near) if near else words))
    return _stack_panels(panels)


def _law_time_series(laws: Sequence[Law], value: Any) -> pd.DataFrame:
    """Tabulate a quantity over time for each control law, thinned for drawing."""
    tables = []
    for law in laws:
        values, t = np.asarray(value(law), dtype=np.float64), law.steps["t_s"].to_numpy()
        shown = extreme_indices(values, _points_per_run(laws))
        tables.append(pd.DataFrame({"law": law.label, "t": t[shown], "value": values[shown]}))
    return pd.concat(tables)


def _points_per_run(laws: Sequence[Law]) -> int:
    return min(MOST, MOST_TOGETHER // len(laws))


def _draw_law_lines(
    table: pd.DataFrame, laws: Sequence[Law], title: str, *, last: bool, log: bool = False
) -> Any:
    scale, axis = style.log_scale() if log else alt.Scale(), alt.Axis(tickCount=4)
    line = (
        alt.Chart(table)
        .mark_line(strokeWidth=1.3, interpolate="step-after")
        .encode(
            x=alt.X("t:Q", title="t [s]" if last else None, scale=alt.Scale(nice=False)),
            y=alt.Y("value:Q", title=title, scale=scale, axis=axis),
            color=_law_colour(laws),
            strokeDash=_law_dash(laws),
        )
    )
    return line.properties(width=_WIDTH, height=84)


def _draw_limits(values: Sequence[float]) -> Any:
    chart = alt.Chart(pd.DataFrame({"limit": list(values)}))
    return chart.mark_rule(strokeDash=[5, 3], color=style.SOFT).encode(y="limit:Q")


def _stack_panels(panels: Sequence[Any]) -> Any:
    shared = alt.Resolve(scale=alt.ScaleResolveMap(x="shared"))
    return alt.vconcat(*panels, spacing=4, resolve=shared)


def _law_colour(laws: Sequence[Law]) -> alt.Color:
    labels = [law.label for law in laws]
    return style.colour("law", labels, style.PALETTE[: len(laws)], labelLimit=260, columns=1)


def _law_dash(laws: Sequence[Law]) -> alt.StrokeDash:
    scale = style.names_scale((law.label for law in laws), [[1, 0], [6, 3]][: len(laws)])
    return alt.StrokeDash("law:N", title=None, scale=scale)


def _equal_axes(table: pd.DataFrame) -> tuple[alt.X, alt.Y]:
    """Return the chart's east and north axes with equal scales, around all points."""
    middle = {a: 0.5 * (table[a].min() + table[a].max()) for a in ("n", "e")}
    half = 0.54 * max(table[a].max() - table[a].min() for a in ("n", "e"))

    def scale(name: str) -> alt.Scale:
        return alt.Scale(domain=[middle[name] - half, middle[name] + half], nice=False)

    return (
        alt.X("e:Q", title="east [m]", scale=scale("e")),
        alt.Y("n:Q", title="north [m]", scale=scale("n")),
    )
