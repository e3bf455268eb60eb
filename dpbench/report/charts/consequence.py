"""Consequence analysis: which loss can be held over time, and what solvers take to say so."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.suites.consequence import HELD, LOST, UNKNOWN
from dpbench.report.charts.style import (
    MEETS,
    MISSES,
    OPEN,
    PAPER,
    coloured,
    log_scale,
    names_scale,
    styled,
    tip,
)

_STATES = {HELD: MEETS, LOST: MISSES, UNKNOWN: OPEN}
_NAMED = 0.45
"""A span of at least this share of the whole says its state in words."""


def spans(table: pd.DataFrame, title: str) -> Any:
    """A bar over time for each group, coloured and named by state.

    Parameters
    ----------
    table : columns `analysis.suites.consequence.SPAN`, groups in the order of the bars.
    """
    first, last = table["from_s"].min(), table["to_s"].max()
    named = table["to_s"] - table["from_s"] >= _NAMED * (last - first)
    table = table.assign(
        middle_s=0.5 * (table["from_s"] + table["to_s"]), text=table["state"].where(named, "")
    )
    present = {state: hue for state, hue in _STATES.items() if state in set(table["state"])}
    base = alt.Chart(table).encode(
        y=alt.Y(
            "group:N",
            title=None,
            sort=list(dict.fromkeys(table["group"])),
            axis=alt.Axis(ticks=False, domain=False),
        ),
        tooltip=[
            alt.Tooltip("group:N", title="lost"),
            alt.Tooltip("state:N"),
            tip("from_s:Q", "from [s]"),
            tip("to_s:Q", "to [s]"),
        ],
    )
    time = alt.Scale(domain=[float(first), float(last)], nice=False)
    colour = coloured("state", present, present.values(), symbolType="square")
    bars = base.mark_bar().encode(
        x=alt.X("from_s:Q", title="time [s]", scale=time, axis=alt.Axis(tickCount=5)),
        x2="to_s:Q",
        color=colour,
    )
    words = base.mark_text(color=PAPER, fontSize=12, fontWeight=600).encode(
        x=alt.X("middle_s:Q", scale=time), text="text:N"
    )
    chart = alt.layer(bars, words, width=250, height=alt.Step(26))
    about = "For each failure group, when the thrusters that remain could hold the ship."
    return styled(chart, title, about)


_RIGHT, _NOT_RIGHT = "all answers right", "wrong or no answer"


def shares(table: pd.DataFrame, title: str) -> Any:
    """Share of the sample that the QPs of one sample take at most, a mark each.

    Parameters
    ----------
    table : columns name, percent and right, in the order of the marks.
    """
    table = table.assign(answers=table["right"].map({True: _RIGHT, False: _NOT_RIGHT}))
    kinds = [kind for kind in (_RIGHT, _NOT_RIGHT) if kind in set(table["answers"])]
    looks = {_RIGHT: (MEETS, "circle"), _NOT_RIGHT: (MISSES, "cross")}
    colours, shapes = ([looks[kind][i] for kind in kinds] for i in (0, 1))
    chart = (
        alt.Chart(table)
        .mark_point(filled=True, size=70, opacity=1)
        .encode(
            x=alt.X(
                "percent:Q",
                title="largest share of a sample [%]",
                scale=log_scale(padding=12),
                axis=alt.Axis(format="~g", tickCount=3, grid=False),
            ),
            y=alt.Y("name:N", title=None, sort=table["name"].tolist(), axis=alt.Axis(grid=True)),
            color=coloured("answers", kinds, colours),
            shape=alt.Shape("answers:N", scale=names_scale(kinds, shapes)),
            tooltip=[
                alt.Tooltip("name:N", title="configuration"),
                tip("percent:Q", "share [%]", 2),
                alt.Tooltip("answers:N"),
            ],
        )
        .properties(width=190, height=alt.Step(18))
    )
    about = "For each solver the largest share of a sample that the QPs of all groups take."
    return styled(chart, title, about)
