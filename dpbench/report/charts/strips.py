"""One run, step by step: time, error, iterations and forces over k."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.bench.record.schema import FORCES
from dpbench.report.charts.style import (
    ACCENT,
    INK,
    LINE,
    MISSES,
    PALETTE,
    SOFT,
    coloured,
    limit_rule,
    log_scale,
    styled,
    tip,
)

COLUMNS = ("k", "time_us", "raw_us", "error", "iterations", "active", "failed")
NO_ANSWER = 1e9
"""What an infinite error is drawn as: JSON has no infinity, and the axis ends below."""
_WIDTH = 620


def strips(table: pd.DataFrame, forces: pd.DataFrame | None, demand_error: float) -> Any:
    """Four strips on one axis, three of a replay, which has no forces; a vertical line stands at
    the parameter `at`.

    Parameters
    ----------
    table : columns `COLUMNS`; `raw_us` the largest timing of a step, NaN in a closed loop.
    forces : columns k, force (of `FORCES`) and share of its limit; None of a replay.
    demand_error : what the error of the first move may be.
    """
    at = alt.param(name="at", value=-1)
    steps = alt.InlineData(name="steps", values=_rows(table))
    rule = (
        alt.Chart(alt.InlineData(values=[{}]))
        .mark_rule(color=ACCENT, strokeWidth=1.5)
        .transform_calculate(at="at")
        .transform_filter("datum.at >= 0")
        .encode(x="at:Q")
        .add_params(at)
    )
    panels = (
        (110, _time(steps)),
        (90, _error(steps, demand_error)),
        (80, _iterations(steps, last=forces is None)),
        *(() if forces is None else ((90, _forces(forces)),)),
    )
    chart = alt.vconcat(
        *(alt.layer(*parts, rule, height=height, width=_WIDTH) for height, parts in panels),
        spacing=6,
        resolve=alt.Resolve(scale=alt.ScaleResolveMap(x="shared")),
    )
    return styled(
        chart,
        "Step by step",
        "Step time, error of the first move, iterations"
        f"{'' if forces is None else ' and forces'} of one run over its steps.",
    )


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [
        {str(k): (None if pd.isna(v) else v) for k, v in row.items()}
        for row in table.to_dict("records")
    ]


def _x(*, last: bool = False) -> alt.X:
    axis = alt.Axis(title="step k" if last else None, labels=last, ticks=last, format="d")
    return alt.X("k:Q", axis=axis, scale=alt.Scale(nice=False, zero=False))


def _time(steps: alt.InlineData) -> tuple[Any, ...]:
    base = (
        alt.Chart(steps)
        # Of a closed loop there is one timing a step.
        .transform_calculate(
            raw="isValid(datum.raw_us) ? format(datum.raw_us, '.3~g') : 'the same'"
        )
        .encode(
            x=_x(),
            tooltip=[
                alt.Tooltip("k:Q"),
                tip("time_us:Q", "step time [µs]"),
                alt.Tooltip("raw:N", title="largest timing [µs]"),
            ],
        )
    )
    y = alt.Y("time_us:Q", title="time [µs]", scale=log_scale(nice=False, padding=5))
    span = base.mark_rule(color=LINE, strokeWidth=1).encode(y=y, y2="raw_us:Q")
    return span, base.mark_circle(size=9, opacity=0.9, color=ACCENT).encode(y=y)


def _error(steps: alt.InlineData, demand_error: float) -> tuple[Any, ...]:
    floor = 1e-16
    base = (
        alt.Chart(steps)
        .transform_calculate(shown=f"datum.error === null ? null : max(datum.error, {floor})")
        .encode(
            x=_x(),
            tooltip=[
                alt.Tooltip("k:Q"),
                tip("error:Q", "error of the first move", 2),
            ],
        )
    )
    y = alt.Y(
        "shown:Q",
        title="error_move",
        scale=log_scale(domainMax=10.0, clamp=True, nice=False),
        axis=alt.Axis(format=".0e", tickCount=5),
    )
    dots = base.mark_circle(size=9, opacity=0.9).encode(
        y=y,
        color=alt.condition("datum.failed", alt.value(MISSES), alt.value(SOFT)),
        size=alt.condition("datum.failed", alt.value(40), alt.value(9)),
    )
    return dots, limit_rule(demand_error)


def _iterations(steps: alt.InlineData, *, last: bool) -> tuple[Any, ...]:
    base = alt.Chart(steps).encode(
        x=_x(last=last),
        tooltip=[alt.Tooltip("k:Q"), alt.Tooltip("iterations:Q"), alt.Tooltip("active:Q")],
    )
    area = base.mark_area(color=LINE, opacity=0.8, interpolate="step").encode(
        y=alt.Y("active:Q", title="iterations, active")
    )
    return area, base.mark_circle(size=9, color=INK, opacity=0.9).encode(y="iterations:Q")


def _forces(forces: pd.DataFrame) -> tuple[Any, ...]:
    tau = alt.InlineData(name="forces", values=_rows(forces))
    base = alt.Chart(tau).encode(x=_x(last=True))
    line = base.mark_line(strokeWidth=1.3, interpolate="step-after").encode(
        y=alt.Y(
            "share:Q",
            title="force / limit",
            scale=alt.Scale(domain=[-1.05, 1.05], clamp=True),
            axis=alt.Axis(values=[-1, 0, 1]),
        ),
        color=coloured("force", FORCES, PALETTE[:3]),
    )
    return (line,)
