"""Figures of single steps: one run over k, and two configurations on the same steps."""

from typing import Any

import altair as alt
import pandas as pd

from dpbench.bench.record.schema import FORCES
from dpbench.report.charts import style

COLUMNS = ("k", "time_us", "raw_us", "error", "iterations", "active", "failed")
NO_ANSWER = 1e9
"""Stands for an infinite error: JSON has no infinity, and the axis ends below."""
_WIDTH = 620


def draw_step_strips(table: pd.DataFrame, forces: pd.DataFrame | None, error_limit: float) -> Any:
    """Return a chart of one run's solve time, error, iterations and forces, over its steps.

    table : columns `COLUMNS`; `raw_us` the largest timing of a step, NaN in a closed loop.
    forces : columns k, force (of `FORCES`) and share of its limit; None of a replay.
    error_limit : limit on the error of the first move.
    """
    at = alt.param(name="at", value=-1)
    steps = _named_chart("steps", table)
    rule = style.inline_chart({}).mark_rule(color=style.ACCENT, strokeWidth=1.5).add_params(at)
    rule = (
        rule.transform_calculate(at="at").transform_filter("datum.at >= 0").encode(x=alt.X("at:Q"))
    )
    panels = [
        (110, _draw_step_times(steps.encode(x=_step_axis()))),
        (90, _draw_step_errors(steps.encode(x=_step_axis()), error_limit)),
        (80, _draw_iterations(steps.encode(x=_step_axis(last=forces is None)))),
    ]
    if forces is not None:
        base = _named_chart("forces", forces).encode(x=_step_axis(last=True))
        panels.append((90, [_draw_force_shares(base)]))
    chart = alt.vconcat(
        *(alt.layer(*parts, rule, height=height, width=_WIDTH) for height, parts in panels),
        spacing=6,
        resolve=alt.Resolve(scale=alt.ScaleResolveMap(x="shared")),
    )
    also = "" if forces is None else " and forces"
    about = f"Step time, error of the first move, iterations{also} of one run over its steps."
    return style.set_style(chart, "Step by step", about)


def _named_chart(name: str, table: pd.DataFrame) -> alt.Chart:
    """Return a chart of a table under a name, by which the page's script replaces the rows."""
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    return style.inline_chart(*({str(k): v for k, v in row.items()} for row in rows), name=name)


def _step_axis(*, last: bool = False) -> alt.X:
    """Return the x axis of step numbers, labelled below the last chart alone."""
    axis = alt.Axis(title="step" if last else None, labels=last, ticks=last, format="d")
    return alt.X("k:Q", axis=axis, scale=alt.Scale(nice=False, zero=False))


def _draw_step_times(steps: alt.Chart) -> list[Any]:
    """Return chart layers of each step's solve time, with a line up to its largest timing."""
    # Of a closed loop there is one timing a step.
    raw = "isValid(datum.raw_us) ? format(datum.raw_us, '.3~g') : 'the same'"
    largest = style.tooltip("raw:N", "largest timing [µs]")
    tips = style.tooltips(
        style.tooltip("k:Q", "step"), style.tooltip("time_us:Q", "step time [µs]"), largest
    )
    apart = style.log_scale(nice=False, padding=5)
    y = alt.Y("time_us:Q", title="time [µs]", scale=apart)
    base = steps.transform_calculate(raw=raw).encode(y=y, tooltip=tips)
    span = base.mark_rule(color=style.LINE, strokeWidth=1).encode(y2=alt.Y2("raw_us:Q"))
    return [span, base.mark_circle(size=9, opacity=0.9, color=style.ACCENT)]


def _draw_step_errors(steps: alt.Chart, error_limit: float) -> list[Any]:
    """Return chart layers of the error of each step's first move, with the limit."""
    scale = style.log_scale(domainMax=10.0, clamp=True, nice=False)
    axis = alt.Axis(format=".0e", tickCount=5)
    shown = f"datum.error === null ? null : max(datum.error, {style.FLOOR})"
    dots = steps.transform_calculate(shown=shown).mark_circle(size=9, opacity=0.9)
    dots = dots.encode(
        tooltip=style.tooltips(
            style.tooltip("k:Q", "step"),
            style.tooltip("error:Q", "error of the first move [maximum increments]", 2),
        ),
        y=alt.Y("shown:Q", title=["error of the", "first move"], scale=scale, axis=axis),
        color=style.value_if("datum.failed", style.FAIL, style.SOFT),
        size=style.value_if("datum.failed", 40, 9),
    )
    return [dots, style.draw_limit_rule(error_limit)]


def _draw_iterations(steps: alt.Chart) -> list[Any]:
    """Return chart layers of each step's iterations over the number of active limits."""
    base = steps.encode(
        tooltip=style.tooltips(
            style.tooltip("k:Q", "step"), "iterations:Q", style.tooltip("active:Q", "active limits")
        )
    )
    area = base.mark_area(color=style.LINE, opacity=0.8, interpolate="step")
    area = area.encode(y=alt.Y("active:Q", title=["iterations,", "active limits"]))
    return [
        area,
        base.mark_circle(size=9, color=style.INK, opacity=0.9).encode(y=alt.Y("iterations:Q")),
    ]


def _draw_force_shares(forces: alt.Chart) -> Any:
    """Return a chart of the forces of a loop over time, as shares of their limits."""
    scale, axis = alt.Scale(domain=[-1.05, 1.05], clamp=True), alt.Axis(values=[-1, 0, 1])
    return forces.mark_line(strokeWidth=1.3, interpolate="step-after").encode(
        y=alt.Y("share:Q", title=["force or", "moment / limit"], scale=scale, axis=axis),
        color=style.colour("force", FORCES, style.PALETTE[:3]),
    )


def draw_step_pairs(first: str, second: str) -> Any:
    """Return a chart of two configurations' step times against each other, without data.

    The page fills the data set `pairs`: k, a_us, b_us, sequence.

    first, second : titles of the axes.
    """
    data = style.inline_chart(name="pairs")
    scale = style.log_scale(nice=False, padding=6)
    dots = data.mark_circle(size=14, opacity=0.5, color=style.ACCENT).encode(
        x=alt.X("a_us:Q", scale=scale, title=f"{first} [µs]"),
        y=alt.Y("b_us:Q", scale=scale, title=f"{second} [µs]"),
        tooltip=style.tooltips(
            "sequence:N",
            style.tooltip("k:Q", "step"),
            style.tooltip("a_us:Q", "horizontal axis [µs]"),
            style.tooltip("b_us:Q", "vertical axis [µs]"),
        ),
    )
    ends = (
        data.transform_calculate(
            low="min(datum.a_us, datum.b_us)", high="max(datum.a_us, datum.b_us)"
        )
        .transform_aggregate(low="min(low)", high="max(high)")
        .transform_fold(["low", "high"], as_=["end", "at"])
        .mark_line(color=style.SOFT, strokeDash=[4, 3])
        .encode(x=alt.X("at:Q"), y=alt.Y("at:Q"))
    )
    return style.set_style(
        alt.layer(dots, ends, width=330, height=330),
        "Two configurations, step by step [µs]",
        "Step times of two configurations against each other; below the line, the "
        "one on the vertical axis is faster.",
    )
