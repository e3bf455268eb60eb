"""Charts of a study: realisations within the radius, and excess errors over the reference."""

from collections.abc import Sequence
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.requirements import STATES
from dpbench.report.charts import style

WITHIN = ("all within", "some within", "none within")
TRIED = ("tried", "front", "own", "chosen")
"""Kinds of tried controllers."""
_LOOKS = [STATES.index(state) for state in ("pass", "inconclusive", "fail")]
"""States with the same looks."""
_SIDE = 110
MOST_TICKS = 6
"""Values of a parameter up to which an axis labels just these."""
_WITHIN = "share of realisations within the radius"
_CHOSEN = "datum.chosen"


def draw_within_maps(table: pd.DataFrame, title: str, x: str, y: str, *, drawn: bool) -> Any:
    """Return a chart of shares within the radius by two parameters, a map per solver.

    table : columns configuration, x, y, within and runs.
    x, y : names of the keys; drawn : place values on axes instead of a grid.
    """
    names = list(dict.fromkeys(table["configuration"]))
    apart = alt.Scale(zero=False)
    across = alt.X("x:O", title=None, axis=alt.Axis(labelAngle=0))
    up = alt.Y("y:O", title=None, sort="descending")
    if drawn:
        across, up = alt.X("x:Q", title=None, scale=apart), alt.Y("y:Q", title=None, scale=apart)
    shade = alt.Color(
        "within:Q",
        title=_WITHIN,
        scale=alt.Scale(domain=[0.0, 0.5, 1.0], range=[style.FAIL, style.FILLS[1], style.PASS]),
        legend=style.legend_below(format=".0%", gradientLength=160, titleLimit=0),
    )
    within = alt.Tooltip("within:Q", title="within", format=".0%")
    tips = style.tooltips(
        "configuration:N", style.tooltip("x:N", x), style.tooltip("y:N", y), within, "runs:Q"
    )
    base = alt.Chart(table).encode(x=across, y=up, color=shade, tooltip=tips)
    marks = base.mark_point(filled=True, size=60, opacity=1) if drawn else base.mark_rect()
    size: Any = _SIDE if drawn else alt.Step(24)
    # A small map has no room for the name of a key: all share one title.
    axes = [f"horizontal: {x}", f"vertical: {y}"]
    looks: dict[str, Any] = {"titleColor": style.SOFT, "titleFontSize": 12, "titleFontWeight": 400}
    place: dict[str, Any] = {"titleOrient": "bottom", "titleAnchor": "start", "titleAlign": "left"}
    shared = alt.Header(**looks, **place)
    each = alt.Facet("configuration:N", title=axes, sort=names, header=shared)
    maps = marks.properties(width=size, height=size).facet(each, columns=3)
    return style.set_style(maps, title, title)


def draw_within_lines(table: pd.DataFrame, title: str, x: str) -> Any:
    """Return a chart of shares within the radius by one parameter, a line per solver."""
    share: dict[str, Any] = {"axis": alt.Axis(format=".0%"), "scale": alt.Scale(domain=[0.0, 1.0])}
    values = sorted(table["x"].unique().tolist())
    # Labels that only do not touch read as one number.
    axis = alt.Axis(values=values, format="~g") if len(values) <= MOST_TICKS else alt.Undefined
    chart = alt.Chart(table).mark_line(point=True)
    chart = chart.encode(
        x=alt.X("x:Q", title=x, scale=alt.Scale(zero=False), axis=axis),
        y=alt.Y("within:Q", title=_WITHIN, **share),
        color=alt.Color("configuration:N", title=None, legend=style.legend_below()),
        tooltip=style.tooltips(
            "configuration:N", style.tooltip("x:Q", x), style.tooltip("within:Q", "within")
        ),
    )
    return style.set_style(chart.properties(width=290, height=180), title, title)


def draw_excess_errors(table: pd.DataFrame, seas: pd.DataFrame, title: str, small_cm: float) -> Any:
    """Return a chart of solvers' position error over the reference: dot per sea, mean, interval.

    table : name and `mean_cm`, in the order of the rows.
    seas : name, error_excess_cm, point, replicate.
    small_cm : half the width of the band of small differences, which is cut off at the axis.
    """
    known = [table[name].astype(float) for name in ("mean_cm", "low_cm", "high_cm")]
    ends = pd.concat([*known, seas["error_excess_cm"]]).dropna()
    low, high = min(float(ends.min()), 0.0), max(float(ends.max()), 0.0)
    axis = alt.Scale(domain=[low, high] if high > low else [-small_cm, small_cm], padding=8)
    rows = style.named_rows("name", table["name"].tolist(), grid=True, labelLimit=260)
    across = "95 % radial error over the reference, same realisation [cm]"
    dots = alt.Chart(seas).mark_point(filled=True, size=14, opacity=0.35, color=style.SOFT)
    behind_it = style.tooltip("error_excess_cm:Q", "excess error [cm]")
    dots = dots.encode(
        x=alt.X("error_excess_cm:Q"),
        y=rows,
        tooltip=style.tooltips("name:N", "point:Q", "replicate:Q", behind_it),
    )
    bars, means = _draw_mean_errors(alt.Chart(table))
    parts = (
        _draw_small_error_band(small_cm, alt.X("low:Q", title=across, scale=axis), clip=True),
        dots,
        bars.encode(y=rows),
        means.encode(y=rows, tooltip=style.tooltips("name:N", *_MEAN_TIPS)),
    )
    return style.set_style(alt.layer(*parts, width=290, height=alt.Step(20)), title, title)


def draw_effects(table: pd.DataFrame, title: str, names: Sequence[str]) -> Any:
    """Return a chart of each factor's effect on each measure: points with intervals, about zero.

    table : columns measure, effect, configuration, value, low, high; names : configurations.
    """
    panels = [
        _draw_effects_on_measure(rows, str(measure), names)
        for measure, rows in table.groupby("measure", sort=False)
    ]
    return style.set_style(alt.vconcat(*panels), title, title)


def _draw_effects_on_measure(table: pd.DataFrame, measure: str, names: Sequence[str]) -> Any:
    """Return a chart layer of the effects on one measure, whose name has its unit."""
    rows = alt.Y("effect:N", title=None, sort=None, axis=alt.Axis(labelLimit=260, grid=True))
    hues = style.PALETTE[: len(names)]
    base = alt.Chart(table).encode(
        y=rows,
        yOffset=alt.YOffset("configuration:N", sort=list(names)),
        color=style.colour("configuration", names, hues, columns=1, labelLimit=320),
        tooltip=style.tooltips(
            *("configuration:N", "effect:N", style.tooltip("value:Q", "change")),
            *(style.tooltip("low:Q", "from"), style.tooltip("high:Q", "to")),
        ),
    )
    zero = alt.Chart(table).mark_rule(color=style.SOFT, strokeDash=[4, 3])
    parts = (
        zero.encode(x=alt.datum(0)),
        base.mark_rule(strokeWidth=2.5).encode(
            x=alt.X("low:Q", title=f"change of {measure}"), x2=alt.X2("high:Q")
        ),
        base.mark_point(filled=True, size=45, opacity=1).encode(x=alt.X("value:Q")),
    )
    step: Any = {"step": max(16, 9 * len(names)), "for": "position"}
    return alt.layer(*parts, width=290, height=step)


_MEAN_TIPS = (
    style.tooltip("mean_cm:Q", "mean [cm]"),
    style.tooltip("low_cm:Q", "from [cm]"),
    style.tooltip("high_cm:Q", "to [cm]"),
    alt.Tooltip("pairs:Q", title="pairs of runs"),
)


def _draw_mean_errors(base: alt.Chart) -> tuple[alt.Chart, alt.Chart]:
    """Return chart layers: intervals and points of mean position errors over the reference's."""
    bars = base.mark_rule(strokeWidth=3, color=style.ACCENT).encode(
        x=alt.X("low_cm:Q"), x2=alt.X2("high_cm:Q")
    )
    means = base.mark_point(filled=True, size=60, color=style.ACCENT, opacity=1).encode(
        x=alt.X("mean_cm:Q")
    )
    return bars, means


def _draw_small_error_band(small_cm: float, low: alt.X | str = "low:Q", **look: Any) -> Any:
    """Return a chart layer: a vertical band over error differences too small to matter."""
    ends = style.inline_chart({"low": -small_cm, "high": small_cm})
    return ends.mark_rect(color=style.GRID, **look).encode(x=low, x2=alt.X2("high:Q"))


def draw_study_points(*, tiles: bool) -> Any:
    """Return a chart, without data, of study points coloured by share of realisations within.

    The page fills the data set `design`: x, y, state (of `WITHIN`), said, chosen, point.
    """
    kind = "O" if tiles else "Q"
    # The page puts the names of the keys, of signals called like this, at the axes.
    x = alt.X(f"x:{kind}", title="across", axis=alt.Axis(labelAngle=0))
    y = alt.Y(f"y:{kind}", title="up", sort="descending" if tiles else alt.Undefined)
    if not tiles:
        x, y = x.scale(zero=False), y.scale(zero=False)
    tips = [style.tooltip("values:N", "point"), style.tooltip("said:N", "realisations within")]
    ring: dict[str, Any] = {"stroke": style.value_if(_CHOSEN, style.ACCENT, style.PAPER)}
    ring["strokeWidth"] = style.value_if(_CHOSEN, 3, 1)
    base = style.inline_chart(name="design").encode(x=x, y=y, tooltip=tips)
    title = "within the radius"
    if tiles:
        fills = [style.FILLS[i] for i in _LOOKS]
        look = style.colour("state", WITHIN, fills, title=title, symbolType="square")
        counts = base.mark_text(fontSize=12, color=style.INK).encode(text=alt.Text("said:N"))
        parts = [base.mark_rect().encode(color=look, **ring), counts]
    else:
        look = style.colour("state", WITHIN, [style.STATE_COLOURS[i] for i in _LOOKS], title=title)
        shapes = alt.Shape(
            "state:N", scale=style.names_scale(WITHIN, [style.STATE_SHAPES[i] for i in _LOOKS])
        )
        marks = base.mark_point(filled=True, size=90, opacity=1)
        parts = [marks.encode(color=look, shape=shapes, **ring)]
    chart = alt.layer(*parts, width=300, height=220)
    return style.set_style(
        chart,
        "Realisations within the radius",
        "Share of realisations at each point of the design.",
    )


def draw_point_errors(small_cm: float) -> Any:
    """Return a chart, without data, of solvers' errors over the reference at a study's point.

    The page fills `means` (name, as of `mean_cm`, c, chosen) and `seas` (name, c, error_excess_cm,
    replicate, chosen).
    """
    who = style.tooltip("name:N", "configuration")
    rows = alt.Y("name:N", title=None, sort=None, axis=style.row_name_axis())
    means = style.inline_chart(name="means").encode(y=rows, tooltip=[who, *_MEAN_TIPS])
    seas = style.inline_chart(name="seas").mark_point(filled=True)
    seas = seas.encode(
        x=alt.X("error_excess_cm:Q", title="95 % radial error over the reference [cm]"),
        y=rows,
        color=style.value_if(_CHOSEN, style.FAIL, style.SOFT),
        size=style.value_if(_CHOSEN, 90, 28),
        opacity=style.value_if(_CHOSEN, 1.0, 0.6),
        tooltip=[
            who,
            alt.Tooltip("replicate:Q", title="realisation"),
            style.tooltip("error_excess_cm:Q", "excess error [cm]"),
        ],
    )
    marked = style.draw_whole_rows(
        means, style.value_if(_CHOSEN, 0.2, 0.0), color=style.ACCENT
    ).add_params(style.narrow_flag())
    parts = (_draw_small_error_band(small_cm, opacity=0.6), marked, *_draw_mean_errors(means), seas)
    chart = alt.layer(*parts, width=430, height=alt.Step(style.ROW_STEP["wide"]))
    about = "Excess error of each configuration over the reference in the same realisations."
    return style.set_style(chart, "Excess error over the reference", about)


def draw_point_seas() -> Any:
    """Return a chart, without data, of largest radial errors in each sea of a study's point.

    The page fills `there`: order, value, who, replicate, chosen; and `radius`: limit.
    """
    radius = (
        style.inline_chart(name="radius")
        .mark_rule(color=style.FAIL, strokeDash=[4, 3])
        .encode(y=alt.Y("limit:Q"))
    )
    who = ("chosen", "reference")
    apart = alt.Scale(zero=False, padding=10)
    whole = alt.Axis(format="d", tickMinStep=1)
    x = alt.X(
        "order:Q", title="realisations of this point, the calmest first", scale=apart, axis=whole
    )
    dots = style.inline_chart(name="there").mark_point(opacity=1)
    dots = dots.encode(
        x=x,
        y=alt.Y("value:Q", title="largest radial error, second half [m]"),
        color=style.colour("who", who, (style.ACCENT, style.SOFT)),
        shape=alt.Shape("who:N", scale=style.names_scale(who, ("circle", "cross"))),
        size=style.value_if(_CHOSEN, 170, 45),
        strokeWidth=style.value_if(_CHOSEN, 3, 1.5),
        tooltip=[
            style.tooltip("who:N", "configuration"),
            alt.Tooltip("replicate:Q", title="realisation"),
            style.tooltip("value:Q", "largest radial error [m]"),
        ],
    )
    about = "Largest radial error in the second half of each run at the chosen point."
    chart = alt.layer(radius, dots, width=430, height=190)
    return style.set_style(chart, "Realisations of one point", about)


def draw_tuning_front(table: pd.DataFrame, title: str, margin: float) -> Any:
    """Return a chart of tried controllers' offset against wear, with the front and the margin.

    table : columns share, wear_per_h, kind (of `TRIED`) and options; margin : largest share.
    """
    x = alt.X("share:Q", title="largest offset [share of the station]", scale=style.log_scale())
    y = alt.Y("wear_per_h:Q", title="wear [largest forces per hour]", scale=style.log_scale())
    looks = (style.NOT_RUN, style.ACCENT, style.INCONCLUSIVE, style.PASS)
    shapes = alt.Shape(
        "kind:N", scale=style.names_scale(TRIED, ("circle", "circle", "square", "diamond"))
    )
    tips = style.tooltips(
        "options:N", style.tooltip("share:Q", "offset"), style.tooltip("wear_per_h:Q", "wear")
    )
    points = alt.Chart(table).mark_point(filled=True, size=70, opacity=1)
    points = points.encode(
        x=x, y=y, color=style.colour("kind", TRIED, looks), shape=shapes, tooltip=tips
    )
    limit = style.draw_limit_rule(margin, "x")
    chart = style.set_style(alt.layer(limit, points, width=420, height=260), title, title)
    chart.title.subtitle = [
        f"dashed line: required margin ({100.0 * margin:g} % of the limits)",
        "own (the original controller) and chosen keep their marks, even on the front",
    ]
    chart.title.subtitleColor = style.SOFT
    return chart
