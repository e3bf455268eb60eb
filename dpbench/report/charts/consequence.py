"""Consequence analysis: which loss can be held over time, and what solvers take to say so."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.suites.consequence import HELD, LOST, UNKNOWN
from dpbench.report.charts import style

_STATES = {HELD: style.PASS, LOST: style.FAIL, UNKNOWN: style.INCONCLUSIVE}
_NAMED = 0.45
"""A span of at least this share of the whole says its state in words."""


def spans(table: pd.DataFrame, title: str) -> Any:
    """Draw a bar over time for each group, coloured and named by state.

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
    groups = list(dict.fromkeys(table["group"]))
    ends = style.tip("from_s:Q", "from [s]"), style.tip("to_s:Q", "to [s]")
    base = alt.Chart(table).encode(
        y=style.named_rows("group", groups, ticks=False, domain=False),
        tooltip=[style.tip("group:N", "lost"), "state:N", *ends],
    )
    time = alt.Scale(domain=[float(first), float(last)], nice=False)
    colour = style.coloured("state", present, present.values(), symbolType="square")
    bars = base.mark_bar().encode(
        x=alt.X("from_s:Q", title="time [s]", scale=time, axis=alt.Axis(tickCount=5)),
        x2="to_s:Q",
        color=colour,
    )
    words = base.mark_text(color=style.PAPER, fontSize=12, fontWeight=600).encode(
        x=alt.X("middle_s:Q", scale=time), text="text:N"
    )
    chart = alt.layer(bars, words, width=250, height=alt.Step(26))
    about = "For each failure group, when the thrusters that remain could hold the ship."
    return style.styled(chart, title, about)


_RIGHT, _NOT_RIGHT = "all answers right", "wrong or no answer"


def shares(table: pd.DataFrame, title: str) -> Any:
    """Draw the largest share of the sample that the QPs of one sample take, a mark each.

    Parameters
    ----------
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
        color=style.coloured("answers", kinds, colours),
        shape=alt.Shape("answers:N", scale=style.names_scale(kinds, shapes)),
        tooltip=[
            style.tip("name:N", "configuration"),
            style.tip("percent:Q", "share [%]", 2),
            "answers:N",
        ],
    )
    about = "For each solver the largest share of a sample that the QPs of all groups take."
    return style.styled(chart.properties(width=190, height=alt.Step(18)), title, about)
