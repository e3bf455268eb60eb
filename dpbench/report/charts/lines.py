"""Lines of one quantity against another, a line a configuration."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts.style import (
    FILLS,
    MEETS,
    MISSES,
    PALETTE,
    alike,
    coloured,
    limit_rule,
    log_scale,
    names_scale,
    styled,
    tip,
)

COLUMNS = ("name", "x", "y", "good")


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
    hues = [PALETTE[i % len(PALETTE)] for i in range(len(names))]
    base = alt.Chart(table).encode(
        x=alt.X(
            "x:Q",
            title=x[0],
            scale=log_scale(nice=False, padding=8),
            axis=alt.Axis(format=x[1]),
        ),
        y=alt.Y("y:Q", title=y[0], scale=log_scale(), axis=alt.Axis(format=y[1])),
        color=coloured("name", names, hues, symbolLimit=40, labelLimit=320, columns=1),
        tooltip=[alt.Tooltip("name:N"), alt.Tooltip("x:Q", title=x[0]), tip("y:Q", y[0])],
    )
    dash = alt.StrokeDash("name:N", scale=names_scale(names, dashes), legend=None)
    joined = base.mark_line(strokeWidth=1.5).encode(strokeDash=dash)
    hue = alt.Color("name:N", scale=names_scale(names, hues), legend=None)
    dots = base.mark_point(size=45, opacity=1, strokeWidth=1.5).encode(
        fill=alt.condition("datum.good", hue, alt.value("white"))
    )
    layers = [joined, dots]
    if limit is not None:
        layers.append(limit_rule(limit))
    return styled(alt.layer(*layers, width=290, height=260), title, title)


def dots(table: pd.DataFrame, title: str, x: str, y: str) -> Any:
    """Measured against asked, a dot each, with the line on which both are alike.

    Parameters
    ----------
    table : columns name, x and y, all positive.
    """
    low, high = 0.6 * table[["x", "y"]].min().min(), 1.6 * table[["x", "y"]].max().max()
    scale = log_scale(domain=[low, high])
    # Between decades the names of ticks would touch.
    decades = alt.Axis(values=[10.0**e for e in range(-3, 7)], format="~g")
    looks: dict[str, Any] = {"scale": scale, "axis": decades}
    line = alike(low, high, alt.X("x:Q", title=x, **looks), alt.Y("y:Q", title=y, **looks))
    points = (
        alt.Chart(table)
        .mark_point(filled=True, size=70, color=PALETTE[0], opacity=1)
        .encode(x="x:Q", y="y:Q", tooltip=["name:N", "x:Q", "y:Q"])
    )
    names = points.mark_text(align="left", dx=8, fontSize=12).encode(text="name:N")
    return styled(alt.layer(line, points, names, width=290, height=240), title, title)


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
        color=alt.condition("datum.count > 0", alt.value(FILLS[3]), alt.value(FILLS[0]))
    )
    numbers = base.mark_text(fontSize=12).encode(
        text="count:Q",
        color=alt.condition("datum.count > 0", alt.value(MISSES), alt.value(MEETS)),
    )
    chart = alt.layer(squares, numbers, width=alt.Step(26), height=alt.Step(20))
    return styled(chart, title, title)
