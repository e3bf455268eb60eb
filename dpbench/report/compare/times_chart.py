"""Two folders side by side: the ratio of step times of each configuration, and both times.

Clicking sets `pick`, the chosen one is marked.
"""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts.style import (
    ACCENT,
    INK,
    MEETS,
    MISSES,
    NOT_RUN,
    ROW_STEP,
    SOFT,
    alike,
    coloured,
    log_scale,
    names_scale,
    narrow,
    picking,
    row_names,
    styled,
    tip,
)

COLUMNS = ("id", "name", "ratio", "low", "high", "verdict", "a_us", "b_us", "sequence")
VERDICTS = ("slower", "faster", "equivalent", "no difference shown")
_COLOURS = (MISSES, MEETS, SOFT, NOT_RUN)
_SHAPES = ("triangle-right", "triangle-left", "circle", "square")


def ratios(table: pd.DataFrame, margin: float) -> Any:
    """B over A less the machine factor, with its interval; dotted: no difference.

    Parameters
    ----------
    table : columns `COLUMNS`, the slowest first; margin : what is no difference.
    """
    base = alt.Chart(table).encode(
        y=alt.Y("name:N", sort=table["name"].tolist(), title=None, axis=row_names(330)),
        color=coloured("verdict", VERDICTS, _COLOURS, columns=2),
        tooltip=_tips(),
    )
    pick = picking("id")
    whole = alt.ExprRef(f"narrow ? {ROW_STEP['narrow']} : 16")
    rows = base.mark_rule(strokeWidth=whole, color=ACCENT).encode(
        x=alt.value(0),
        x2=alt.value("width"),
        color=alt.value(ACCENT),
        opacity=alt.condition(pick, alt.value(0.16), alt.value(0.0)),
    )
    rows = rows.add_params(narrow(), pick)
    x = alt.X(
        "ratio:Q",
        title="B / A, machine factor taken out",
        scale=log_scale(),
        axis=alt.Axis(orient="top", format="~g", labelOverlap="greedy"),
    )
    spans = base.mark_rule(strokeWidth=1.5).encode(x=alt.X("low:Q"), x2="high:Q")
    points = base.mark_point(filled=True, size=60, opacity=1).encode(x=x, shape=_shape())
    edges = pd.DataFrame({"edge": [1.0 / (1.0 + margin), 1.0, 1.0 + margin]})
    rules = alt.Chart(edges).mark_rule(color=INK, strokeDash=[2, 3]).encode(x="edge:Q")
    chart = alt.layer(rows, rules, spans, points, width=430, height=alt.Step(17))
    return styled(chart, "What became slower", "Ratio of step times of each configuration.")


def both(table: pd.DataFrame) -> Any:
    """Median step time in B against A on equal axes, a mark a configuration and sequence."""
    low = 0.8 * float(table[["a_us", "b_us"]].min().min())
    high = 1.25 * float(table[["a_us", "b_us"]].max().max())
    scale = log_scale(domain=[low, high])
    x = alt.X("a_us:Q", title="A: median step time [µs]", scale=scale)
    y = alt.Y("b_us:Q", title="B: median step time [µs]", scale=scale)
    pick = picking("id")
    points = (
        alt.Chart(table)
        .mark_point(filled=True, opacity=0.9)
        .encode(
            x=x,
            y=y,
            color=coloured("verdict", VERDICTS, _COLOURS, columns=2),
            shape=_shape(),
            size=alt.condition(pick, alt.value(260), alt.value(55)),
            tooltip=_tips(),
        )
        .add_params(pick)
    )
    chart = alt.layer(alike(low, high, x, y), points, width=330, height=330)
    return styled(chart, "Both runs", "Median step times of both runs against each other.")


def _shape() -> alt.Shape:
    return alt.Shape("verdict:N", scale=names_scale(VERDICTS, _SHAPES), title=None)


def _tips() -> list[alt.Tooltip]:
    return [
        alt.Tooltip("name:N", title="configuration"),
        alt.Tooltip("verdict:N"),
        *(tip(f"{name}:Q") for name in ("ratio", "low", "high")),
        tip("a_us:Q", "A [µs]"),
        tip("b_us:Q", "B [µs]"),
    ]
