"""The rose of a ship's capability: the largest wind it holds, by where it comes from; and what
solvers answer at that edge."""

from __future__ import annotations

from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from dpbench.arrays import Floats
from dpbench.report.charts.style import (
    GRID,
    INK,
    LINE,
    MEETS,
    MISSES,
    PALETTE,
    PAPER,
    SOFT,
    coloured,
    styled,
    tip,
)
from dpbench.ship.capability.conditions import DP_CONDITIONS

COLUMNS = ("case", "from_deg", "wind_mps", "number")
SIZE = 380
_OUTER = max(wind for wind, *_ in DP_CONDITIONS.values())
_RING_CORNERS = 91
"""Of the polygon that is drawn as a ring: every 4°, the first again at the end."""
_RINGS = (3, 5, 6, 7, 8, 9, 10, 11)
"""DP capability numbers whose winds are drawn as rings; below they lie too close."""
_BETWEEN_DEG = np.arange(15.0, 360.0, 30.0)
"""Directions between two spokes: the rings are named along one of them."""
_CLEAR_MPS = 1.8
"""A line nearer than this to a ring touches its name."""


def rose(table: pd.DataFrame, title: str) -> Any:
    """A closed line for each case; ahead is up, starboard to the right, rings are DP numbers.

    Parameters
    ----------
    table : columns `COLUMNS`, directions clockwise from ahead; cases in the order of the legend.
        With a column `untrue`, how many solvers made an untrue claim there, points with any are
        hollow.
    """
    cases = list(dict.fromkeys(table["case"]))
    closed = pd.concat([_closed(table[table["case"] == case]) for case in cases])
    span = alt.Scale(domain=[-1.12 * _OUTER, 1.12 * _OUTER], nice=False)
    x = alt.X("x:Q", scale=span, axis=None)
    y = alt.Y("y:Q", scale=span, axis=None)
    lines = (
        alt.Chart(closed)
        .mark_line(strokeWidth=2, interpolate="linear")
        .encode(
            x=x,
            y=y,
            order="i:Q",
            color=coloured("case", cases, PALETTE[: len(cases)], columns=3),
        )
    )
    points = _points(closed, x, y)
    web = [_rings(x, y), _spokes(x, y), *_ring_names(x, y, closed), _bearings(x, y)]
    about = (
        "Largest wind held from each direction, intact and after each failure; rings: the winds of "
        "DP capability numbers."
    )
    layers = alt.layer(*web, lines, *points, width=SIZE, height=SIZE)
    chart = styled(layers, title, about)
    chart.title.subtitle = [
        "by where wind, waves and current come from;",
        "rings: DP capability numbers",
    ]
    chart.title.subtitleColor = SOFT
    return chart


def _points(closed: pd.DataFrame, x: alt.X, y: alt.Y) -> list[Any]:
    """A mark for each direction, hollow where a solver made an untrue claim."""
    tooltips = [
        alt.Tooltip("case:N"),
        tip("from_deg:Q", "from [°]"),
        tip("wind_mps:Q", "wind held [m/s]", 3),
        alt.Tooltip("number:Q", title="DP capability number"),
    ]
    untrue = closed["untrue"] if "untrue" in closed else pd.Series(0, closed.index)
    if (untrue > 0).any():
        tooltips.append(alt.Tooltip("untrue:Q", title="solvers with an untrue claim"))
    kinds = ((closed[untrue == 0], 14, True), (closed[untrue > 0], 30, False))
    return [
        alt.Chart(of_kind)
        .mark_point(size=size, filled=filled, opacity=1, fill=alt.Undefined if filled else PAPER)
        .encode(x=x, y=y, color="case:N", tooltip=tooltips)
        for of_kind, size, filled in kinds
        if len(of_kind)
    ]


def _at(radius: Any, from_deg: Any) -> dict[str, Any]:
    """Coordinates of a wind (…) from a direction (…): ahead is up."""
    angle = np.radians(from_deg)
    return {"x": radius * np.sin(angle), "y": radius * np.cos(angle)}


def _closed(case: pd.DataFrame) -> pd.DataFrame:
    """The rows of a case with the first one again at the end."""
    ring = pd.concat([case, case.iloc[:1]])
    places = _at(ring["wind_mps"].to_numpy(), ring["from_deg"].to_numpy())
    return ring.assign(**places, i=range(len(ring)))


def _rings(x: alt.X, y: alt.Y) -> Any:
    turn = np.linspace(0.0, 360.0, _RING_CORNERS)
    rings = [
        pd.DataFrame({**_at(DP_CONDITIONS[n][0], turn), "i": range(len(turn)), "n": n})
        for n in _RINGS
    ]
    chart = alt.Chart(pd.concat(rings)).mark_line(color=GRID, strokeWidth=1)
    return chart.encode(x=x, y=y, detail="n:N", order="i:Q")


def _spokes(x: alt.X, y: alt.Y) -> Any:
    spokes = [
        pd.DataFrame({**_at(np.array([0.0, _OUTER]), from_deg), "spoke": from_deg})
        for from_deg in range(0, 360, 30)
    ]
    chart = alt.Chart(pd.concat(spokes)).mark_line(color=GRID, strokeWidth=1)
    return chart.encode(x=x, y=y, detail="spoke:N")


def _ring_names(x: alt.X, y: alt.Y, closed: pd.DataFrame) -> tuple[Any, Any]:
    """The number of each ring, clear of the lines, on a patch of the paper."""
    winds = [DP_CONDITIONS[n][0] for n in _RINGS]
    places = zip(_RINGS, winds, _clear_deg(closed, np.array(winds)), strict=True)
    names = [{**_at(wind, from_deg), "name": f"{n}"} for n, wind, from_deg in places]
    text = alt.Chart(pd.DataFrame(names)).encode(x=x, y=y, text="name:N")
    patch = text.mark_text(fontSize=12, stroke=PAPER, strokeWidth=4)
    return patch, text.mark_text(fontSize=12, color=SOFT)


def _clear_deg(closed: pd.DataFrame, winds: Floats) -> Floats:
    """Where each ring (R,) is named: along the one direction between spokes in which the lines keep
    off most rings, and a ring that they do not keep off there in the direction best for itself."""
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


def _bearings(x: alt.X, y: alt.Y) -> Any:
    bearings = [
        {**_at(1.07 * _OUTER, from_deg), "name": f"{from_deg}°"} for from_deg in range(0, 360, 30)
    ]
    chart = alt.Chart(pd.DataFrame(bearings)).mark_text(color=INK, fontSize=12)
    return chart.encode(x=x, y=y, text="name:N")


ANSWERS = ("solver", "answer", "share", "qps")
RIGHT_HELD, RIGHT_NOT, NOTHING, WRONG = (
    "held, right",
    "not held, right",
    "no answer",
    "untrue claim",
)
_LOOKS = {RIGHT_HELD: PALETTE[0], RIGHT_NOT: MEETS, NOTHING: LINE, WRONG: MISSES}


def answers(table: pd.DataFrame, title: str) -> Any:
    """A bar for each solver: which share of the QPs at the edge it answers how.

    Parameters
    ----------
    table : columns `ANSWERS`, a row for each solver and kind of answer; solvers from the top.
    """
    kinds = [kind for kind in _LOOKS if (table.loc[table["answer"] == kind, "qps"] > 0).any()]
    place = {kind: i for i, kind in enumerate(_LOOKS)}
    table = table.assign(place=table["answer"].map(place))
    chart = (
        alt.Chart(table[table["qps"] > 0])
        .mark_bar()
        .encode(
            x=alt.X(
                "share:Q",
                title="share of the QPs [%]",
                scale=alt.Scale(domain=[0, 100]),
                axis=alt.Axis(values=[0, 25, 50, 75, 100], grid=False),
            ),
            y=alt.Y("solver:N", title=None, sort=list(dict.fromkeys(table["solver"]))),
            order="place:Q",
            color=coloured(
                "answer", kinds, map(_LOOKS.__getitem__, kinds), symbolType="square", columns=2
            ),
            tooltip=[alt.Tooltip("solver:N"), alt.Tooltip("answer:N"), alt.Tooltip("qps:Q")],
        )
        .properties(width=250, height=alt.Step(17))
    )
    about = "For each solver, how many of the QPs at the edge it answers rightly, wrongly or not."
    return styled(chart, title, about)
