"""Two folders side by side: the ratio of step times of each configuration, and both times.

Clicking sets `pick`, the chosen one is marked.
"""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts import style

VERDICTS = ("slower", "faster", "equivalent", "no difference shown")
_COLOUR = style.coloured(
    "verdict", VERDICTS, (style.MISSES, style.MEETS, style.SOFT, style.NOT_RUN), columns=2
)
_SHAPES = style.names_scale(VERDICTS, ("triangle-right", "triangle-left", "circle", "square"))
_SHAPE = alt.Shape("verdict:N", scale=_SHAPES, title=None)
_TIPS = [
    style.tip("name:N", "configuration"),
    "verdict:N",
    *(style.tip(f"{name}:Q") for name in ("ratio", "low", "high")),
    style.tip("a_us:Q", "A [µs]"),
    style.tip("b_us:Q", "B [µs]"),
]


def ratios(table: pd.DataFrame, margin: float) -> Any:
    """B over A less the machine factor, with its interval; dotted: no difference.

    Parameters
    ----------
    table : of `analysis.compare.ratio_table`; margin : what is no difference.
    """
    base = alt.Chart(table).encode(
        y=alt.Y("name:N", sort=table["name"].tolist(), title=None, axis=style.row_names(330)),
        color=_COLOUR,
        tooltip=_TIPS,
    )
    pick = style.picking("id")
    rows = style.whole_rows(base, style.either(pick, 0.16, 0.0), 16, color=style.ACCENT)
    rows = rows.encode(color=alt.value(style.ACCENT)).add_params(style.narrow(), pick)
    axis = alt.Axis(orient="top", format="~g", labelOverlap="greedy")
    title = "B / A, machine factor taken out"
    x = alt.X("ratio:Q", title=title, scale=style.log_scale(), axis=axis)
    spans = base.mark_rule(strokeWidth=1.5).encode(x=alt.X("low:Q"), x2="high:Q")
    points = base.mark_point(filled=True, size=60, opacity=1).encode(x=x, shape=_SHAPE)
    edges = pd.DataFrame({"edge": [1.0 / (1.0 + margin), 1.0, 1.0 + margin]})
    rules = alt.Chart(edges).mark_rule(color=style.INK, strokeDash=[2, 3]).encode(x="edge:Q")
    chart = alt.layer(rows, rules, spans, points, width=430, height=alt.Step(17))
    return style.styled(chart, "What became slower", "Ratio of step times of each configuration.")


def both(table: pd.DataFrame) -> Any:
    """Median step time in B against A on equal axes, a mark a configuration and sequence."""
    low = 0.8 * float(table[["a_us", "b_us"]].min().min())
    high = 1.25 * float(table[["a_us", "b_us"]].max().max())
    scale = style.log_scale(domain=[low, high])
    x = alt.X("a_us:Q", title="A: median step time [µs]", scale=scale)
    y = alt.Y("b_us:Q", title="B: median step time [µs]", scale=scale)
    pick = style.picking("id")
    points = alt.Chart(table).mark_point(filled=True, opacity=0.9)
    looks: dict[str, Any] = {"color": _COLOUR, "shape": _SHAPE, "tooltip": _TIPS}
    points = points.encode(x=x, y=y, **looks, size=style.either(pick, 260, 55)).add_params(pick)
    chart = alt.layer(style.alike(low, high, x, y), points, width=330, height=330)
    return style.styled(chart, "Both runs", "Median step times of both runs against each other.")
