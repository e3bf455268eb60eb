"""A study: what is held where, and how far configurations are behind in the same seas."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.verdict import STATES
from dpbench.report.charts.style import (
    ACCENT,
    FILLS,
    GRID,
    INK,
    MEETS,
    MISSES,
    PAPER,
    ROW_STEP,
    SOFT,
    STATE_COLOURS,
    STATE_SHAPES,
    coloured,
    names_scale,
    narrow,
    row_names,
    styled,
    tip,
)

MAP_COLUMNS = ("configuration", "x", "y", "held", "runs")
BEHIND_COLUMNS = ("name", "mean_cm", "low_cm", "high_cm", "pairs")
SEA_COLUMNS = ("name", "behind_cm", "point", "replicate")
HELD = ("all held", "some held", "none held")
"""What is said of the seas at a point."""
_LOOKS = [STATES.index(state) for state in ("meets", "open", "wrong")]
"""The states whose looks these have."""
_SIDE = 110


def held_maps(table: pd.DataFrame, title: str, x: str, y: str, *, drawn: bool) -> Any:
    """Share of seas held over two keys, a map a configuration.

    Parameters
    ----------
    table : columns `MAP_COLUMNS`.
    x, y : names of the keys; drawn : whether their values are drawn, and so no grid.
    """
    names = list(dict.fromkeys(table["configuration"]))
    apart = alt.Scale(zero=False)
    across = alt.X("x:O", title=x, axis=alt.Axis(labelAngle=0))
    up = alt.Y("y:O", title=y, sort="descending")
    if drawn:
        across, up = alt.X("x:Q", title=x, scale=apart), alt.Y("y:Q", title=y, scale=apart)
    shade = alt.Color(
        "held:Q",
        title="share of seas held",
        scale=alt.Scale(domain=[0.0, 0.5, 1.0], range=[MISSES, "#faeccc", MEETS]),
        legend=alt.Legend(orient="bottom", format=".0%", gradientLength=160),
    )
    tips = [
        alt.Tooltip("configuration:N"),
        alt.Tooltip("x:N", title=x),
        alt.Tooltip("y:N", title=y),
        alt.Tooltip("held:Q", format=".0%"),
        alt.Tooltip("runs:Q"),
    ]
    base = alt.Chart(table).encode(x=across, y=up, color=shade, tooltip=tips)
    marks = base.mark_point(filled=True, size=60, opacity=1) if drawn else base.mark_rect()
    size: Any = _SIDE if drawn else alt.Step(24)
    chart = marks.properties(width=size, height=size).facet(
        alt.Facet("configuration:N", title=None, sort=names), columns=3
    )
    return styled(chart, title, title)


def held_lines(table: pd.DataFrame, title: str, x: str) -> Any:
    """Share of seas held over one key, a line a configuration; columns `MAP_COLUMNS`."""
    chart = (
        alt.Chart(table)
        .mark_line(point=True)
        .encode(
            x=alt.X("x:Q", title=x, scale=alt.Scale(zero=False)),
            y=alt.Y(
                "held:Q",
                title="share of seas held",
                axis=alt.Axis(format=".0%"),
                scale=alt.Scale(domain=[0.0, 1.0]),
            ),
            color=alt.Color("configuration:N", title=None, legend=alt.Legend(orient="bottom")),
            tooltip=[alt.Tooltip("configuration:N"), tip("x:Q", x), tip("held:Q")],
        )
        .properties(width=290, height=180)
    )
    return styled(chart, title, title)


def behind(table: pd.DataFrame, seas: pd.DataFrame, title: str, small_cm: float) -> Any:
    """How far each configuration is behind the reference: a dot a sea, the mean and its interval.

    Parameters
    ----------
    table : columns `BEHIND_COLUMNS`, in the order of the rows; seas : columns `SEA_COLUMNS`.
    small_cm : what is small, drawn as a band.
    """
    names = table["name"].tolist()
    rows = alt.Y("name:N", title=None, sort=names, axis=alt.Axis(grid=True, labelLimit=260))
    across = "95 % radial error behind the reference, same sea [cm]"
    band = (
        alt.Chart(alt.InlineData(values=[{"low": -small_cm, "high": small_cm}]))
        .mark_rect(color=GRID)
        .encode(x=alt.X("low:Q", title=across), x2="high:Q")
    )
    dots = (
        alt.Chart(seas)
        .mark_point(filled=True, size=14, opacity=0.35, color=SOFT)
        .encode(
            x="behind_cm:Q",
            y=rows,
            tooltip=[
                alt.Tooltip("name:N"),
                alt.Tooltip("point:Q"),
                alt.Tooltip("replicate:Q"),
                tip("behind_cm:Q", "behind [cm]"),
            ],
        )
    )
    bars = (
        alt.Chart(table)
        .mark_rule(strokeWidth=3, color=ACCENT)
        .encode(x="low_cm:Q", x2="high_cm:Q", y=rows)
    )
    means = (
        alt.Chart(table)
        .mark_point(filled=True, size=60, color=ACCENT, opacity=1)
        .encode(
            x="mean_cm:Q",
            y=rows,
            tooltip=[
                alt.Tooltip("name:N"),
                tip("mean_cm:Q", "mean [cm]"),
                tip("low_cm:Q", "from [cm]"),
                tip("high_cm:Q", "to [cm]"),
                alt.Tooltip("pairs:Q", title="seas"),
            ],
        )
    )
    chart = alt.layer(band, dots, bars, means, width=290, height=alt.Step(20))
    return styled(chart, title, title)


def design(*, tiles: bool) -> Any:
    """The points of a design over two keys, coloured by how many of their seas are held: as tiles
    with counts, or each where its values are. The page fills the data set `design`: x, y, state (of
    `HELD`), said, chosen, point.
    """
    points = alt.InlineData(name="design", values=[])
    kind = "O" if tiles else "Q"
    # The page puts the names of the keys, of signals called like this, at the axes.
    x = alt.X(f"x:{kind}", title="across", axis=alt.Axis(labelAngle=0))
    y = alt.Y(f"y:{kind}", title="up", sort="descending" if tiles else alt.Undefined)
    if not tiles:
        x, y = x.scale(zero=False), y.scale(zero=False)
    tips = [
        alt.Tooltip("values:N", title="point"),
        alt.Tooltip("said:N", title="seas held"),
    ]
    base = alt.Chart(points).encode(x=x, y=y, tooltip=tips)
    title = "within the radius"
    ring = alt.condition("datum.chosen", alt.value(ACCENT), alt.value(PAPER))
    thick = alt.condition("datum.chosen", alt.value(3), alt.value(1))
    height = 220
    if not tiles:
        look = coloured("state", HELD, [STATE_COLOURS[i] for i in _LOOKS], title=title)
        shapes = names_scale(HELD, [STATE_SHAPES[i] for i in _LOOKS])
        shape = alt.Shape("state:N", scale=shapes)
        marks = base.mark_point(filled=True, size=90, opacity=1).encode(
            color=look, shape=shape, stroke=ring, strokeWidth=thick
        )
        chart = alt.layer(marks, width=300, height=height)
    else:
        fills = [FILLS[i] for i in _LOOKS]
        look = coloured("state", HELD, fills, title=title, symbolType="square")
        marks = base.mark_rect().encode(color=look, stroke=ring, strokeWidth=thick)
        counts = base.mark_text(fontSize=12, color=INK).encode(text="said:N")
        chart = alt.layer(marks, counts, width=300, height=height)
    return styled(chart, "Seas held", "Share of seas held at each point of the design.")


def behind_there(small_cm: float) -> Any:
    """How far each configuration is behind the reference: a dot a sea of the chosen point, mean and
    interval over all points. The page fills `means` (columns `BEHIND_COLUMNS`, c, chosen) and
    `seas` (name, c, behind_cm, replicate, chosen).
    """
    means = alt.Chart(alt.InlineData(name="means", values=[])).encode(
        y=_rows(),
        tooltip=[
            alt.Tooltip("name:N", title="configuration"),
            tip("mean_cm:Q", "mean [cm]"),
            tip("low_cm:Q", "from [cm]"),
            tip("high_cm:Q", "to [cm]"),
            alt.Tooltip("pairs:Q", title="seas"),
        ],
    )
    whole = alt.ExprRef(f"narrow ? {ROW_STEP['narrow']} : {ROW_STEP['wide']}")
    rows = means.mark_rule(strokeWidth=whole, color=ACCENT).encode(
        x=alt.value(0),
        x2=alt.value("width"),
        opacity=alt.condition("datum.chosen", alt.value(0.2), alt.value(0.0)),
    )
    band = (
        alt.Chart(alt.InlineData(values=[{"low": -small_cm, "high": small_cm}]))
        .mark_rect(color=GRID, opacity=0.6)
        .encode(x="low:Q", x2="high:Q")
    )
    bars = means.mark_rule(strokeWidth=3, color=ACCENT).encode(x="low_cm:Q", x2="high_cm:Q")
    middle = means.mark_point(filled=True, size=60, color=ACCENT, opacity=1).encode(x="mean_cm:Q")
    parts = (band, rows.add_params(narrow()), bars, middle, _seas_behind())
    chart = alt.layer(*parts, width=430, height=alt.Step(ROW_STEP["wide"]))
    about = "How far each configuration is behind the reference in the same seas."
    return styled(chart, "Behind the reference", about)


def _rows() -> alt.Y:
    return alt.Y("name:N", title=None, sort=None, axis=row_names())


def _seas_behind() -> Any:
    """A dot for each sea of the chosen point."""
    chosen = "datum.chosen"
    return (
        alt.Chart(alt.InlineData(name="seas", values=[]))
        .mark_point(filled=True)
        .encode(
            x=alt.X("behind_cm:Q", title="95 % radial error behind the reference [cm]"),
            y=_rows(),
            color=alt.condition(chosen, alt.value(MISSES), alt.value(SOFT)),
            size=alt.condition(chosen, alt.value(90), alt.value(28)),
            opacity=alt.condition(chosen, alt.value(1.0), alt.value(0.6)),
            tooltip=[
                alt.Tooltip("name:N", title="configuration"),
                alt.Tooltip("replicate:Q", title="sea"),
                tip("behind_cm:Q", "behind [cm]"),
            ],
        )
    )


def seas_there() -> Any:
    """The seas of the chosen point, those calm for the reference first: how far off the chosen
    configuration and the reference are. The page fills `there`: order, value, who, replicate,
    chosen; and `radius`: limit.
    """
    radius = (
        alt.Chart(alt.InlineData(name="radius", values=[]))
        .mark_rule(color=MISSES, strokeDash=[4, 3])
        .encode(y="limit:Q")
    )
    there = alt.InlineData(name="there", values=[])
    who = ("chosen", "reference")
    dots = (
        alt.Chart(there)
        .mark_point(opacity=1)
        .encode(
            x=alt.X(
                "order:Q",
                title="seas of this point, the calmest first",
                scale=alt.Scale(zero=False, padding=10),
                axis=_whole(),
            ),
            y=alt.Y("value:Q", title="largest radial error, second half [m]"),
            color=coloured("who", who, (ACCENT, SOFT)),
            shape=alt.Shape("who:N", scale=names_scale(who, ("circle", "cross"))),
            size=alt.condition("datum.chosen", alt.value(170), alt.value(45)),
            strokeWidth=alt.condition("datum.chosen", alt.value(3), alt.value(1.5)),
            tooltip=[
                alt.Tooltip("who:N", title="configuration"),
                alt.Tooltip("replicate:Q", title="sea"),
                tip("value:Q", "largest radial error [m]"),
            ],
        )
    )
    chart = alt.layer(radius, dots, width=430, height=190)
    about = "Largest radial error in the second half of each run at the chosen point."
    return styled(chart, "The seas of one point", about)


def _whole() -> alt.Axis:
    return alt.Axis(format="d", tickMinStep=1)
