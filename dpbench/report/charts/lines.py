"""Lines of one quantity against another, a line a configuration."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts.style import MISSES, SOFT, styled

COLUMNS = ("name", "x", "y", "good")
PALETTE = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#7f7f7f",
    "#8c510a",
)
"""Colour-blind safe (Okabe and Ito); a ninth line has the first colour with another dash."""


def lines(
    table: pd.DataFrame,
    title: str,
    x: tuple[str, str],
    y: tuple[str, str],
    *,
    limit: float | None = None,
) -> Any:
    """Lines with points on logarithmic axes; a point that is not `good` is hollow.

    Parameters
    ----------
    table : columns `COLUMNS`, x and y positive.
    x, y : title and format of each axis; limit : drawn across.
    """
    names = list(dict.fromkeys(table["name"]))
    dashes = [[[1, 0], [6, 3], [2, 2]][(i // len(PALETTE)) % 3] for i in range(len(names))]
    base = alt.Chart(table).encode(
        x=alt.X(
            "x:Q",
            title=x[0],
            scale=alt.Scale(type="log", nice=False, padding=8),
            axis=alt.Axis(format=x[1]),
        ),
        y=alt.Y("y:Q", title=y[0], scale=alt.Scale(type="log"), axis=alt.Axis(format=y[1])),
        color=alt.Color(
            "name:N",
            title=None,
            scale=alt.Scale(
                domain=names, range=[PALETTE[i % len(PALETTE)] for i in range(len(names))]
            ),
            legend=alt.Legend(symbolLimit=40, labelLimit=260),
        ),
        tooltip=[
            alt.Tooltip("name:N"),
            alt.Tooltip("x:Q", title=x[0]),
            alt.Tooltip("y:Q", title=y[0], format=".4~g"),
        ],
    )
    joined = base.mark_line(strokeWidth=1.5).encode(
        strokeDash=alt.StrokeDash(
            "name:N", scale=alt.Scale(domain=names, range=dashes), legend=None
        )
    )
    dots = base.mark_point(filled=True, size=45, opacity=1).encode(
        fillOpacity=alt.condition("datum.good", alt.value(1.0), alt.value(0.0)),
    )
    layers = [joined, dots]
    if limit is not None:
        rule = alt.Chart(pd.DataFrame({"limit": [limit]})).mark_rule(
            color=MISSES, strokeDash=[4, 3]
        )
        layers.append(rule.encode(y="limit:Q"))
    return styled(alt.layer(*layers).properties(width=520, height=330), title, title)


def dots(table: pd.DataFrame, title: str, x: str, y: str) -> Any:
    """Measured against asked, a dot each, with the line on which both are alike.

    Parameters
    ----------
    table : columns name, x and y, all positive.
    """
    low, high = 0.6 * table[["x", "y"]].min().min(), 1.6 * table[["x", "y"]].max().max()
    scale = alt.Scale(type="log", domain=[low, high])
    line = (
        alt.Chart(pd.DataFrame({"x": [low, high], "y": [low, high]}))
        .mark_line(color=SOFT, strokeDash=[4, 3])
        .encode(x=alt.X("x:Q", title=x, scale=scale), y=alt.Y("y:Q", title=y, scale=scale))
    )
    points = (
        alt.Chart(table)
        .mark_point(filled=True, size=70, color=PALETTE[0], opacity=1)
        .encode(x="x:Q", y="y:Q", tooltip=["name:N", "x:Q", "y:Q"])
    )
    names = points.mark_text(align="left", dx=8, fontSize=12).encode(text="name:N")
    return styled(alt.layer(line, points, names).properties(width=330, height=260), title, title)


def tiles(table: pd.DataFrame, title: str, x: str, y: str) -> Any:
    """Counts as tiles with the number in each; zero is pale.

    Parameters
    ----------
    table : columns x, y, count.
    """
    base = alt.Chart(table).encode(
        x=alt.X(
            "x:N",
            title=None,
            sort=list(dict.fromkeys(table["x"])),
            axis=alt.Axis(orient="top", labelAngle=-40),
        ),
        y=alt.Y("y:N", title=None, sort=list(dict.fromkeys(table["y"]))),
        tooltip=[alt.Tooltip("y:N", title=y), alt.Tooltip("x:N", title=x), alt.Tooltip("count:Q")],
    )
    squares = base.mark_rect(stroke="white").encode(
        color=alt.condition("datum.count > 0", alt.value("#f9d8c4"), alt.value("#d7efe6"))
    )
    numbers = base.mark_text(fontSize=12).encode(
        text="count:Q",
        color=alt.condition("datum.count > 0", alt.value(MISSES), alt.value("#1b7f5c")),
    )
    chart = alt.layer(squares, numbers).properties(width=alt.Step(44), height=alt.Step(20))
    return styled(chart, title, title)
