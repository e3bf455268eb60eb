"""The deadline ladder: what a step takes with each solver, against the time there is."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.findings import STATES
from dpbench.report.charts import style

LOWEST_MS = 1e-3
"""Left end of the axis."""
ROOM = 300
"""A figure of so many pixels has room for the limits in full."""
_JITTER = "slow <= 1 ? '' : 'dashed: ' + (narrow ? '' : 'jitter of this machine, ') + 'as measured'"
"""What is said of the whiskers on a slower computer."""


def _state() -> str:
    """Return the expression of the verdict on the slower computer: late beyond the speed margin."""
    good = " || ".join(
        f"datum.verdict == '{state}'" for state in ("pass", "borderline", "inconclusive")
    )
    return f"({good}) && slow > 1 && slow > datum.margin ? 'late' : datum.verdict"


def ladder(table: pd.DataFrame, deadline_ms: float, p99_ms: float) -> Any:
    """Draw p50, p99, hardest step and largest single timing of each solver against the deadline.

    The parameter `slow` scales all but the largest timing, which is this machine's; colours are
    verdicts there. With `narrow` names stand above their bars; clicking sets `pick`.

    Parameters
    ----------
    table : columns `analysis.times.solver_tables.TIMES`, the first row on top.
    p99_ms : limit of the requirements.
    """
    base = _scaled(table)
    x = _axis(table, deadline_ms)
    parts = (*_rows(base), *_times(base, x), *_limits(deadline_ms, p99_ms))
    return style.styled(
        alt.layer(*parts, width=560, height=alt.Step(style.ROW_STEP["wide"])),
        "How close to the deadline",
        "Step times of each solver from median over p99 to the largest, against the deadline.",
    )


def _scaled(table: pd.DataFrame) -> alt.Chart:
    scaled = alt.Chart(table).transform_calculate(
        a="datum.p50_ms * slow",
        c="isValid(datum.p99_ms) ? datum.p99_ms * slow : datum.p50_ms * slow",
        m="datum.max_ms * slow",
        called="datum.p50_ms * datum.share * slow",
        left=f"{LOWEST_MS}",
        now=_state(),
        computer="'× ' + format(slow, '.3~g')",
        timing="format(datum.longest_ms, '.3~g') + (slow > 1 ? ', as measured' : '')",
    )
    times = (("a", "p50"), ("c", "p99, worst scenario"), ("m", "hardest step"))
    tips = [
        style.tip("label:N", "configuration"),
        style.tip("computer:N", "computer slower"),
        style.tip("now:N", "verdict there"),
        *(style.tip(f"{name}:Q", f"{title} [ms]", 3) for name, title in times),
        style.tip("replay_p99_ms:Q", "p99, whole replay, as measured [ms]", 3),
        style.tip("raw_p99_ms:Q", "p99 of single timings there [ms]", 3),
        style.tip("timing:N", "largest single timing [ms]"),
        style.tip("margin:Q", "speed margin ×", 3),
    ]
    y = alt.Y("label:N", sort=table["label"].tolist(), title=None, axis=style.row_names())
    return scaled.encode(y=y, tooltip=tips)


def _axis(table: pd.DataFrame, deadline_ms: float) -> alt.X:
    """Return an axis to ten times the deadline, or on to the slowest time there."""
    slowest = float(table[["max_ms", "longest_ms"]].max().max())
    high = max(10.0 * deadline_ms, 1.0)
    highest = alt.ExprRef(f"max({high}, {1.5 * slowest if isfinite(slowest) else 0.0} * slow)")
    scale = style.log_scale(domainMin=LOWEST_MS, domainMax=highest, clamp=True)
    axis = alt.Axis(
        values=[10.0**e for e in range(-3, 8)],
        format="~g",
        orient="top",
        labelOverlap="greedy",
        labelSeparation=6,
        offset=alt.ExprRef("narrow ? 8 : 0"),  # off the name above the first bar
    )
    return alt.X("a:Q", title="step time [ms], log scale", scale=scale, axis=axis)


def _rows(base: alt.Chart) -> Iterator[Any]:
    """Draw the areas that take clicks, and the mark of the chosen row."""
    pick = style.picking("id")
    factor = alt.param(name="slow", value=1.0)
    clicked = style.whole_rows(base, alt.Undefined, opacity=0.0)
    yield clicked.add_params(factor, style.narrow(), pick)
    yield style.whole_rows(base, style.either(pick, 0.25, 0.0), color=style.ACCENT)


def _times(base: alt.Chart, x: alt.X) -> Iterator[Any]:
    """Draw the call overhead, whisker, line, bar and marker of each row."""
    columns = alt.ExprRef("width < 200 ? 2 : narrow || width < 400 ? 3 : 5")
    looks: dict[str, Any] = {"columns": columns, "offset": 40}  # below what is said of the limits
    colour = style.coloured("now", STATES, style.STATE_COLOURS, title="verdict", **looks)
    yield base.mark_rule(strokeWidth=9, color=style.LINE).encode(
        x=alt.X("left:Q"), x2="called:Q", opacity=alt.value(0.7)
    )
    yield (
        base.transform_filter("datum.longest_ms > datum.m")
        .mark_rule(strokeWidth=1, color=style.SOFT, strokeDash=[2, 2])
        .encode(x=alt.X("m:Q"), x2="longest_ms:Q")
    )
    yield base.mark_rule(strokeWidth=2).encode(x=x, x2="m:Q", color=colour)
    yield base.mark_rule(strokeWidth=9, strokeCap="butt").encode(x=x, x2="c:Q", color=colour)
    shape = alt.Shape("now:N", scale=style.names_scale(STATES, style.STATE_SHAPES))
    yield base.mark_point(filled=True, size=70, opacity=1).encode(x=x, color=colour, shape=shape)


def _limits(deadline_ms: float, p99_ms: float) -> Iterator[Any]:
    """Draw deadline and p99 limit with their names, and the remark on the whiskers below."""
    words: dict[str, Any] = {"baseline": "top", "fontSize": 12}
    limits = (
        ("p99", p99_ms, f"p99 limit {p99_ms:g} ms", 0.75, style.LATE),
        ("deadline", deadline_ms, f"deadline {deadline_ms:g} ms", 1.5, style.INK),
    )
    for name, at_ms, text, thick, colour in limits:
        # On paper there is room for the first word alone.
        said = f"width < {ROOM} ? '{name}' : '{text}'"
        chart = alt.Chart(pd.DataFrame({name: [at_ms]})).transform_calculate(text=said)
        yield chart.mark_rule(color=colour, strokeWidth=thick).encode(x=f"{name}:Q")
        # Left of its line; the deadline's, to keep off that, right of it, or below where it is near
        # the end of the axis.
        right, near = name == "deadline", f"scale('x', {at_ms}) + 110 > width"
        aside: dict[str, Any] = {"align": "right", "dx": -5}
        if right:
            aside["align"] = alt.ExprRef(f"{near} ? 'center' : 'left'")
            aside["dx"] = alt.ExprRef(f"{near} ? 0 : 5")
        yield chart.mark_text(dy=4, color=colour, **aside, **words).encode(
            x=f"{name}:Q", y=alt.value("height"), text="text:N"
        )
    whiskers = style.inline({}).mark_text(align="left", dy=20, color=style.SOFT, **words)
    place: dict[str, Any] = {"x": alt.value(0), "y": alt.value("height")}
    yield whiskers.encode(**place, text="said:N").transform_calculate(said=_JITTER)
