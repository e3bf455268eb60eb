"""Lines of one quantity against another, a line a configuration."""

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts import style

COLUMNS = ("name", "x", "y", "good")


def draw_lines(
    table: pd.DataFrame,
    title: str,
    x: tuple[str, str],
    y: tuple[str, str],
    *,
    limit: float | None = None,
) -> Any:
    """Return a chart of y over x, a line per solver configuration, log axes; bad points hollow.

    table : columns `COLUMNS`, x and y positive.
    x, y : title and format of each axis; limit : drawn across.
    """
    names = list(dict.fromkeys(table["name"]))
    dashes = [[[1, 0], [6, 3], [2, 2]][(i // len(style.PALETTE)) % 3] for i in range(len(names))]
    hues = [style.PALETTE[i % len(style.PALETTE)] for i in range(len(names))]
    close = style.log_scale(nice=False, padding=8)
    base = alt.Chart(table).encode(
        x=alt.X("x:Q", title=x[0], scale=close, axis=alt.Axis(format=x[1])),
        y=alt.Y("y:Q", title=y[0], scale=style.log_scale(), axis=alt.Axis(format=y[1])),
        color=style.colour("name", names, hues, symbolLimit=40, labelLimit=320, columns=1),
        tooltip=style.tooltips(
            "name:N", alt.Tooltip("x:Q", title=x[0]), style.tooltip("y:Q", y[0])
        ),
    )
    dash = alt.StrokeDash("name:N", scale=style.names_scale(names, dashes), legend=None)
    joined = base.mark_line(strokeWidth=1.5).encode(strokeDash=dash)
    hue = alt.Color("name:N", scale=style.names_scale(names, hues), legend=None)
    dots = base.mark_point(size=45, opacity=1, strokeWidth=1.5).encode(
        fill=alt.condition("datum.good", hue, alt.value("white"))
    )
    layers = [joined, dots]
    if limit is not None:
        layers.append(style.draw_limit_rule(limit))
    return style.set_style(alt.layer(*layers, width=290, height=260), title, title)


def draw_dots(table: pd.DataFrame, title: str, x: str, y: str) -> Any:
    """Return a chart of measured over requested values as dots, with the line of equality.

    table : columns name, x and y, all positive.
    """
    low, high = 0.6 * table[["x", "y"]].min().min(), 1.6 * table[["x", "y"]].max().max()
    scale = style.log_scale(domain=[low, high])
    # Between decades the names of ticks would touch.
    decades = alt.Axis(values=[10.0**e for e in range(-3, 7)], format="~g")
    looks: dict[str, Any] = {"scale": scale, "axis": decades}
    line = style.draw_equality_line(
        low, high, alt.X("x:Q", title=x, **looks), alt.Y("y:Q", title=y, **looks)
    )
    points = alt.Chart(table).mark_point(filled=True, size=70, color=style.PALETTE[0], opacity=1)
    points = points.encode(
        x=alt.X("x:Q"), y=alt.Y("y:Q"), tooltip=style.tooltips("name:N", "x:Q", "y:Q")
    )
    names = points.mark_text(align="left", dx=8, fontSize=12).encode(text=alt.Text("name:N"))
    return style.set_style(alt.layer(line, points, names, width=290, height=240), title, title)


def draw_count_tiles(table: pd.DataFrame, title: str, x: str, y: str) -> Any:
    """Return a chart of a table of counts by two keys as tiles, with the number in each."""
    columns, rows = (list(dict.fromkeys(table[name])) for name in ("x", "y"))
    above = alt.Axis(orient="top", labelAngle=-40)
    base = alt.Chart(table).encode(
        x=alt.X("x:N", title=None, sort=columns, axis=above),
        y=alt.Y("y:N", title=None, sort=rows),
        tooltip=style.tooltips(style.tooltip("y:N", y), style.tooltip("x:N", x), "count:Q"),
    )
    some = "datum.count > 0"
    squares = base.mark_rect(stroke="white").encode(
        color=style.value_if(some, style.FILLS[3], style.FILLS[0])
    )
    numbers = base.mark_text(fontSize=12).encode(
        text=alt.Text("count:Q"), color=style.value_if(some, style.FAIL, style.PASS)
    )
    chart = alt.layer(squares, numbers, width=alt.Step(26), height=alt.Step(20))
    return style.set_style(chart, title, title)
