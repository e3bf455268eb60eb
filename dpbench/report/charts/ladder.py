"""The deadline ladder: what a step takes with each solver, against the time there is."""

from __future__ import annotations

from math import isfinite
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.verdict import OUTCOMES
from dpbench.report.charts.style import (
    ACCENT,
    INK,
    LINE,
    OUTCOME_COLOURS,
    OUTCOME_SHAPES,
    ROW_STEP,
    SOFT,
    coloured,
    log_scale,
    names_scale,
    narrow,
    picking,
    row_names,
    styled,
    tip,
)

COLUMNS = ("id", "solver", "label", "outcome", "p50_ms", "p99_ms", "max_ms", "raw_max_ms", "share")
"""`share`: part of the median that calling the library costs, by the harness's own solver."""
LOWEST_MS = 1e-3
"""Left end of the axis."""
_JITTER = (
    "slow <= 1 ? '' : narrow ? 'dashed: not scaled' : 'dashed: jitter of this machine, not scaled'"
)
"""What is said of the whiskers on a slower computer."""


def _outcome(deadline_ms: float, p99_ms: float) -> str:
    """What the demand finds on the slower computer, as an expression: a largest step beyond the
    deadline or a p99 beyond its limit misses; without a p99 it is open."""
    late = f"datum.max_ms * slow > {deadline_ms} || datum.p99_ms * slow > {p99_ms}"
    unknown = f"!isValid(datum.p99_ms) && datum.max_ms * slow > {p99_ms} && slow > 1"
    later = f"({late}) ? 'misses' : ({unknown}) ? 'open' : datum.outcome"
    return f"datum.outcome == 'meets' || datum.outcome == 'open' ? ({later}) : datum.outcome"


def ladder(table: pd.DataFrame, deadline_ms: float, p99_ms: float) -> Any:
    """A row per solver: bar from p50 to p99, line on to the largest step, whisker to the largest
    timing, where that is the longer one.

    The parameter `slow` of the chart scales all but that whisker, which is this machine's, and the
    colours say what the demand finds then; with `narrow` names stand above their bars; clicking
    sets `pick`.

    Parameters
    ----------
    table : columns `COLUMNS`, the first row on top.
    p99_ms : what the demand allows.
    """
    order = table["label"].tolist()
    factor = alt.param(name="slow", value=1.0)
    pick = picking("id")
    base = (
        alt.Chart(table)
        .transform_calculate(
            a="datum.p50_ms * slow",
            c="isValid(datum.p99_ms) ? datum.p99_ms * slow : datum.p50_ms * slow",
            m="datum.max_ms * slow",
            called="datum.p50_ms * datum.share * slow",
            left=f"{LOWEST_MS}",
            now=_outcome(deadline_ms, p99_ms),
            computer="'× ' + format(slow, '.3~g')",
            timing="slow > 1 ? 'not scaled' : format(datum.raw_max_ms, '.3~g')",
        )
        .encode(y=alt.Y("label:N", sort=order, title=None, axis=row_names()))
    )
    high, slowest = max(10.0 * deadline_ms, 1.0), float(table["max_ms"].max())
    highest = alt.ExprRef(f"max({high}, {1.5 * slowest if isfinite(slowest) else 0.0} * slow)")
    x = alt.X(
        "a:Q",
        title="step time [ms], log scale",
        scale=log_scale(domainMin=LOWEST_MS, domainMax=highest, clamp=True),
        axis=alt.Axis(
            values=[10.0**e for e in range(-3, 8)], format="~g", orient="top", labelOverlap="greedy"
        ),
    )
    columns = alt.ExprRef("narrow ? 2 : 4")
    colour = coloured("now", OUTCOMES, OUTCOME_COLOURS, title="demand", columns=columns)
    shape = alt.Shape("now:N", scale=names_scale(OUTCOMES, OUTCOME_SHAPES))
    tips = [
        alt.Tooltip("label:N", title="configuration"),
        alt.Tooltip("computer:N", title="computer slower"),
        alt.Tooltip("now:N", title="demand there"),
        *(
            tip(f"{name}:Q", f"{title} [ms]", 3)
            for name, title in (
                ("a", "p50"),
                ("c", "p99"),
                ("m", "largest step"),
            )
        ),
        alt.Tooltip("timing:N", title="largest timing [ms]"),
    ]
    whole = alt.ExprRef(f"narrow ? {ROW_STEP['narrow']} : {ROW_STEP['wide']}")
    rows = base.mark_rule(strokeWidth=whole, opacity=0.0).encode(
        x=alt.value(0), x2=alt.value("width"), tooltip=tips
    )
    rows = rows.add_params(factor, narrow(), pick)
    chosen = base.mark_rule(strokeWidth=whole, color=ACCENT).encode(
        x=alt.value(0),
        x2=alt.value("width"),
        opacity=alt.condition(pick, alt.value(0.25), alt.value(0.0)),
        tooltip=tips,
    )
    whisker = (
        base.transform_filter("datum.raw_max_ms > datum.m")
        .mark_rule(strokeWidth=1, color=SOFT, strokeDash=[2, 2])
        .encode(x=alt.X("m:Q"), x2="raw_max_ms:Q", tooltip=tips)
    )
    line = base.mark_rule(strokeWidth=2).encode(x=x, x2="m:Q", color=colour, tooltip=tips)
    bar = base.mark_rule(strokeWidth=9, strokeCap="butt").encode(
        x=x, x2="c:Q", color=colour, tooltip=tips
    )
    calling = base.mark_rule(strokeWidth=9, color=LINE).encode(
        x=alt.X("left:Q"), x2="called:Q", opacity=alt.value(0.7), tooltip=tips
    )
    point = base.mark_point(filled=True, size=70, opacity=1).encode(
        x=x, color=colour, shape=shape, tooltip=tips
    )
    limit = pd.DataFrame({"deadline": [deadline_ms], "text": [f"deadline {deadline_ms:g} ms"]})
    deadline = alt.Chart(limit).mark_rule(color=INK, strokeWidth=1.5).encode(x="deadline:Q")
    named = (
        alt.Chart(limit)
        .mark_text(align="right", dx=-5, dy=4, baseline="top", color=INK, fontSize=12)
        .encode(x="deadline:Q", y=alt.value("height"), text="text:N")
    )
    jitter = (
        alt.Chart(limit)
        .mark_text(align="left", dy=4, baseline="top", color=SOFT, fontSize=12)
        .encode(x=alt.value(0), y=alt.value("height"), text="said:N")
        .transform_calculate(said=_JITTER)
    )
    parts = (rows, chosen, calling, whisker, line, bar, point, deadline, named, jitter)
    return styled(
        alt.layer(*parts, width=560, height=alt.Step(ROW_STEP["wide"])),
        "How close to the deadline",
        "Step times of each solver from median over p99 to the largest, against the deadline.",
    )
