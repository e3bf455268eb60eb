"""Solver × place × settings: where the demand is met, open, missed (late, wrong), never asked."""

from __future__ import annotations

import json
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.verdict import STATES
from dpbench.report.charts.style import (
    ACCENT,
    FILLS,
    INK,
    PAPER,
    STATE_COLOURS,
    coloured,
    picking,
    styled,
)

COLUMNS = (
    *("solver", "place", "settings", "way", "state"),
    *("error", "failed", "id", "place_id", "detail"),
)
MARKS = ("✓", "?", "▸", "✕", "–")
"""Of the states."""
MOST_ACROSS = 30
"""Places side by side; more would leave no room for a name."""


def matrix(table: pd.DataFrame, *, stacked: bool = False) -> Any:
    """A tile for every solver and place, side by side for each settings level, or one below the
    other for a narrow screen.

    Colour and sign say the same; the tooltip has the largest error and the failed steps. Clicking
    sets `pick`.

    More places than `MOST_ACROSS` stand below each other, solvers side by side.

    Parameters
    ----------
    table : columns `COLUMNS`, solvers and places in the order they are to stand in.
    """
    solvers, places = table["solver"].unique().tolist(), table["place"].unique().tolist()
    levels = table["settings"].unique().tolist()
    # Worked out in the figure, so that the page can hand it other rows.
    signs = json.dumps(dict(zip(STATES, MARKS, strict=True)), ensure_ascii=False)
    inks = json.dumps(dict(zip(STATES, STATE_COLOURS, strict=True)))
    pick = picking("id", "place_id")
    long = len(places) > MOST_ACROSS
    across, down = ("solver", "place") if long else ("place", "solver")
    order = {"solver": solvers, "place": places}
    x = alt.X(
        f"{across}:N",
        sort=order[across],
        title=None,
        axis=alt.Axis(orient="top", labelAngle=-90 if stacked else -40),
    )
    y = alt.Y(f"{down}:N", sort=order[down], title=None)
    tips = [
        alt.Tooltip("solver:N"),
        alt.Tooltip("way:N"),
        alt.Tooltip("settings:N"),
        alt.Tooltip("place:N", title="in"),
        alt.Tooltip("state:N", title="demand"),
        alt.Tooltip("off:N", title="largest error_move"),
        alt.Tooltip("fails:N", title="failed steps"),
        alt.Tooltip("because:N", title="why"),
    ]
    base = (
        alt.Chart()
        .transform_calculate(
            off="isValid(datum.error) ? format(datum.error, '.2~g') : '–'",
            fails="isValid(datum.failed) ? datum.failed : '–'",
            because="datum.detail || '–'",
        )
        .encode(x=x, y=y, tooltip=tips)
    )
    # One below the other the tiles are narrower than five words side by side.
    legend: dict[str, Any] = {
        "symbolType": "square",
        "labelExpr": f"{signs}[datum.label] + ' ' + datum.label",
    }
    legend |= {"columns": 3} if stacked else {}
    tiles = base.mark_rect(strokeWidth=1.5, stroke=PAPER).encode(
        color=coloured("state", STATES, FILLS, title="demand", **legend)
    )
    # Above all tiles, or those beside it would cover half of its frame.
    frame: dict[str, Any] = {"filled": False, "stroke": ACCENT, "strokeWidth": 3, "aria": False}
    chosen = base.transform_filter(pick).mark_rect(**frame)
    signed = base.transform_calculate(sign=f"{signs}[datum.state]", ink=f"{inks}[datum.state]")
    text = signed.mark_text(fontSize=12, fontWeight=600).encode(
        text="sign:N",
        color=alt.Color("ink:N", scale=None),
    )
    header = alt.Header(
        labelFontSize=13,
        labelFontWeight=600,
        labelAnchor="start",
        labelColor=INK,
        labelOrient="top",
        labelAngle=0,
    )
    tiles = tiles.add_params(pick)
    placed = alt.layer(
        tiles, text, chosen, data=table, width=alt.Step(30), height=alt.Step(15 if long else 22)
    )
    own: dict[str, Any] = {"sort": levels, "title": None, "header": header}
    if stacked:
        chart = placed.facet(row=alt.Row("settings:N", **own), spacing=14)
        chart = chart.resolve_axis(x="independent")
    else:
        chart = placed.facet(column=alt.Column("settings:N", **own), spacing=14)
    return styled(
        chart,
        "Where each solver holds",
        "Tiles of solver by scenario: meets, open, late, wrong or not run, for each settings "
        "level.",
    )
