"""Capability rose with the answers of solvers at its edge, and consequence analysis."""

from collections.abc import Iterable
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from dpbench.analysis.suites.capability import HELD, LOST, UNKNOWN
from dpbench.arrays import Floats
from dpbench.bench.capability.frontier import INTACT
from dpbench.report.charts import style
from dpbench.report.formats import floor_to_tenth
from dpbench.ship.capability.loads import DP_CONDITIONS

COLUMNS = ("case", "from_deg", "wind_mps", "number")
SIZE = 380
_OUTER = max(wind for wind, *_ in DP_CONDITIONS.values())
_RING_CORNERS = 91
"""Corners of the polygon of a ring: every 4°, the first again at the end."""
_RINGS = (3, 5, 6, 7, 8, 9, 10, 11)
"""DP capability numbers with a ring; lower ones are too close to each other."""
_SPOKES_DEG = range(0, 360, 30)
_BETWEEN_DEG = np.arange(15.0, 360.0, 30.0)
"""Directions between two spokes, one of which has the names of the rings."""
_SHORT_NAME = 18
"""Letters of a curve's name of which three fit a line of the legend."""
_CLEAR_MPS = 1.8
"""A line nearer than this to a ring touches its name."""


def draw_capability_rose(table: pd.DataFrame, title: str) -> Any:
    """Return a polar chart of the largest wind a ship holds by direction, a curve per failure.

    table : columns `COLUMNS`, directions clockwise from ahead. Points are hollow where an optional
        column `untrue` counts solvers with an untrue claim. The legend has the intact ship first,
        then the worst failure.
    """
    table = table.assign(shown_mps=table["wind_mps"].map(floor_to_tenth))
    least = table.groupby("case", sort=False)["shown_mps"].min()
    cases = sorted(
        least.index, key=lambda case: (not case.startswith(INTACT), case != INTACT, least[case])
    )
    rings = []
    for case in cases:
        own = table[table["case"] == case]
        own = pd.concat([own, own.iloc[:1]])  # closed: the first row again at the end
        places = _polar_coordinates(own["wind_mps"].to_numpy(), own["from_deg"].to_numpy())
        rings.append(own.assign(**places, i=range(len(own))))
    closed = pd.concat(rings)
    span = alt.Scale(domain=[-1.12 * _OUTER, 1.12 * _OUTER], nice=False)
    place = {"x": alt.X("x:Q", scale=span, axis=None), "y": alt.Y("y:Q", scale=span, axis=None)}
    columns = 3 if max(map(len, cases)) <= _SHORT_NAME else 2
    colour = style.colour(
        "case", cases, style.PALETTE[: len(cases)], columns=columns, labelLimit=SIZE // columns
    )
    lines = alt.Chart(closed).mark_line(strokeWidth=2, interpolate="linear")
    lines = lines.encode(**place, order=alt.Order("i:Q"), color=colour)
    points = _draw_points(closed, place)
    turn, ends = np.linspace(0.0, 360.0, _RING_CORNERS), np.array([0.0, _OUTER])
    circles = [
        {**_polar_coordinates(DP_CONDITIONS[n][0], turn), "i": range(len(turn)), "n": n}
        for n in _RINGS
    ]
    spokes = [{**_polar_coordinates(ends, bearing), "spoke": bearing} for bearing in _SPOKES_DEG]
    bearings = [
        {**_polar_coordinates(1.07 * _OUTER, deg), "name": f"{deg}°"} for deg in _SPOKES_DEG
    ]
    web = [
        _draw_web_lines(circles, place).encode(detail=alt.Detail("n:N"), order=alt.Order("i:Q")),
        _draw_web_lines(spokes, place).encode(detail=alt.Detail("spoke:N")),
        *_draw_ring_names(place, closed),
        alt.Chart(pd.DataFrame(bearings))
        .mark_text(color=style.INK, fontSize=12)
        .encode(**place, text=alt.Text("name:N")),
    ]
    about = (
        "Largest wind held from each direction, intact and after each failure; rings: the winds of "
        "DP capability numbers."
    )
    layers = alt.layer(*web, lines, *points, width=SIZE, height=SIZE)
    chart = style.set_style(layers, title, about)
    chart.title.subtitle = [
        "by the direction from which the weather comes;",
        "rings: DP capability numbers",
    ]
    chart.title.subtitleColor = style.SOFT
    return chart


Place = dict[str, Any]


def _draw_points(closed: pd.DataFrame, place: Place) -> list[Any]:
    """Return chart layers: largest winds held as points, hollow where solvers claim falsely."""
    tooltips = style.tooltips(
        "case:N",
        style.tooltip("from_deg:Q", "from [°]"),
        alt.Tooltip("shown_mps:Q", title="wind held [m/s]", format=".1f"),
        alt.Tooltip("number:Q", title="DP capability number"),
    )
    untrue = closed["untrue"] if "untrue" in closed else pd.Series(0, closed.index)
    if (untrue > 0).any():
        tooltips.append(alt.Tooltip("untrue:Q", title="solvers with an untrue claim"))
    kinds = ((closed[untrue == 0], 14, True), (closed[untrue > 0], 30, False))
    return [
        alt.Chart(of_kind)
        .mark_point(
            size=size, filled=filled, opacity=1, fill=alt.Undefined if filled else style.PAPER
        )
        .encode(**place, color=alt.Color("case:N"), tooltip=tooltips)
        for of_kind, size, filled in kinds
        if len(of_kind)
    ]


def _polar_coordinates(radius: Any, from_deg: Any) -> dict[str, Any]:
    """Return chart x and y of wind speeds by directions off the bow [°]; ahead is up."""
    angle = np.radians(from_deg)
    return {"x": radius * np.sin(angle), "y": radius * np.cos(angle)}


def _draw_web_lines(parts: Iterable[dict[str, Any]], place: Place) -> Any:
    """Return a chart layer of the polar wind chart's grid, rings or spokes, as thin lines."""
    chart = alt.Chart(pd.concat(map(pd.DataFrame, parts)))
    return chart.mark_line(color=style.GRID, strokeWidth=1).encode(**place)


def _draw_ring_names(place: Place, closed: pd.DataFrame) -> tuple[Any, Any]:
    """Return two chart layers, outlines and text, of the numbers at the polar chart's rings."""
    winds = [DP_CONDITIONS[n][0] for n in _RINGS]
    places = zip(_RINGS, winds, _find_clear_deg(closed, np.array(winds)), strict=True)
    names = [{**_polar_coordinates(wind, from_deg), "name": f"{n}"} for n, wind, from_deg in places]
    text = alt.Chart(pd.DataFrame(names)).encode(**place, text=alt.Text("name:N"))
    patch = text.mark_text(fontSize=12, stroke=style.PAPER, strokeWidth=4)
    return patch, text.mark_text(fontSize=12, color=style.SOFT)


def _find_clear_deg(closed: pd.DataFrame, winds: Floats) -> Floats:
    """Return the direction [°] in which each wind ring (R,) is labelled, clear of the curves."""
    held = np.array(
        [
            np.interp(_BETWEEN_DEG, case["from_deg"], case["wind_mps"], period=360.0)
            for _, case in closed.groupby("case", sort=False)
        ]
    )
    gaps = np.abs(held[:, :, None] - winds).min(axis=0)
    common = np.argmax((gaps > _CLEAR_MPS).sum(axis=1))
    own = np.where(gaps[common] > _CLEAR_MPS, common, np.argmax(gaps, axis=0))
    return _BETWEEN_DEG[own]


ANSWERS = ("solver", "answer", "share", "qps")
RIGHT_HELD, RIGHT_NOT = "held, right", "not held, right"
NOTHING, WRONG = "no answer", "untrue claim"
_LOOKS = {
    RIGHT_HELD: style.PALETTE[0],
    RIGHT_NOT: style.PASS,
    NOTHING: style.LINE,
    WRONG: style.FAIL,
}


def draw_answer_shares(table: pd.DataFrame, title: str) -> Any:
    """Return a chart of each solver's shares of right, wrong, missing answers to capability QPs.

    table : columns `ANSWERS`, a row for each solver and kind of answer; solvers from the top.
    """
    there = table[table["qps"] > 0]
    hues = {kind: hue for kind, hue in _LOOKS.items() if (there["answer"] == kind).any()}
    place = {kind: i for i, kind in enumerate(_LOOKS)}
    scale = alt.Scale(domain=[0, 100])
    axis = alt.Axis(values=[0, 25, 50, 75, 100], grid=False)
    chart = alt.Chart(there.assign(place=there["answer"].map(place))).mark_bar()
    chart = chart.encode(
        x=alt.X("share:Q", title="share of the QPs [%]", scale=scale, axis=axis),
        y=alt.Y("solver:N", title=None, sort=list(dict.fromkeys(table["solver"]))),
        order=alt.Order("place:Q"),
        color=style.colour("answer", hues, hues.values(), symbolType="square", columns=2),
        tooltip=style.tooltips("solver:N", "answer:N", "qps:Q"),
    )
    about = "For each solver, how many of the QPs at the edge it answers rightly, wrongly or not."
    return style.set_style(chart.properties(width=250, height=alt.Step(17)), title, about)


_STATES = {HELD: style.PASS, LOST: style.FAIL, UNKNOWN: style.INCONCLUSIVE}
_NAMED = 0.45
"""Least share of the whole axis of a span that has room for the name of its state."""


def draw_loss_spans(table: pd.DataFrame, title: str) -> Any:
    """Return a chart of when the ship can hold position after losing thrusters, a bar per loss.

    table : columns `analysis.suites.consequence.SPAN`, groups in the order of the bars.
    """
    first, last = table["from_s"].min(), table["to_s"].max()
    named = table["to_s"] - table["from_s"] >= _NAMED * (last - first)
    table = table.assign(
        middle_s=0.5 * (table["from_s"] + table["to_s"]), text=table["state"].where(named, "")
    )
    present = {state: hue for state, hue in _STATES.items() if state in set(table["state"])}
    groups = list(dict.fromkeys(table["group"]))
    ends = style.tooltip("from_s:Q", "from [s]"), style.tooltip("to_s:Q", "to [s]")
    base = alt.Chart(table).encode(
        y=style.named_rows("group", groups, ticks=False, domain=False),
        tooltip=style.tooltips(style.tooltip("group:N", "lost"), "state:N", *ends),
    )
    time = alt.Scale(domain=[float(first), float(last)], nice=False)
    colour = style.colour("state", present, present.values(), symbolType="square")
    bars = base.mark_bar().encode(
        x=alt.X("from_s:Q", title="time [s]", scale=time, axis=alt.Axis(tickCount=5)),
        x2=alt.X2("to_s:Q"),
        color=colour,
    )
    words = base.mark_text(color=style.PAPER, fontSize=12, fontWeight=600).encode(
        x=alt.X("middle_s:Q", scale=time), text=alt.Text("text:N")
    )
    chart = alt.layer(bars, words, width=250, height=alt.Step(26))
    about = "For each failure group, when the thrusters that remain could hold the ship."
    return style.set_style(chart, title, about)


_RIGHT, _NOT_RIGHT = "all answers right", "wrong or no answer"


def draw_sample_shares(table: pd.DataFrame, title: str) -> Any:
    """Return a chart of the largest share of a control sample each solver takes for a QP batch.

    table : columns name, percent and right, in the order of the marks.
    """
    table = table.assign(answers=table["right"].map({True: _RIGHT, False: _NOT_RIGHT}))
    kinds = [kind for kind in (_RIGHT, _NOT_RIGHT) if kind in set(table["answers"])]
    looks = {_RIGHT: (style.PASS, "circle"), _NOT_RIGHT: (style.FAIL, "cross")}
    colours, shapes = ([looks[kind][i] for kind in kinds] for i in (0, 1))
    axis = alt.Axis(format="~g", tickCount=3, grid=False)
    across = "largest share of a sample [%]"
    chart = alt.Chart(table).mark_point(filled=True, size=70, opacity=1)
    chart = chart.encode(
        x=alt.X("percent:Q", title=across, scale=style.log_scale(padding=12), axis=axis),
        y=style.named_rows("name", table["name"].tolist(), grid=True),
        color=style.colour("answers", kinds, colours),
        shape=alt.Shape("answers:N", scale=style.names_scale(kinds, shapes)),
        tooltip=style.tooltips(
            style.tooltip("name:N", "configuration"),
            style.tooltip("percent:Q", "share [%]", 2),
            "answers:N",
        ),
    )
    about = "For each solver the largest share of a sample that the QPs of all groups take."
    return style.set_style(chart.properties(width=190, height=alt.Step(18)), title, about)
