"""A study: what is held where, and how far configurations are behind in the same seas."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts.style import ACCENT, GRID, MEETS, MISSES, SOFT, styled, tip

MAP_COLUMNS = ("configuration", "x", "y", "held", "runs")
BEHIND_COLUMNS = ("name", "mean_cm", "low_cm", "high_cm", "pairs")
SEA_COLUMNS = ("name", "behind_cm", "point", "replicate")
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
