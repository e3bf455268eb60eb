"""Solver × experiment × settings: the verdict on each run."""

from __future__ import annotations

import json
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.findings import STATES
from dpbench.report.charts import style

COLUMNS = (
    *("solver", "experiment", "settings", "call_mode", "verdict"),
    *("error", "failed", "id", "experiment_id", "detail"),
)
MARKS = ("✓", "≈", "?", "▸", "✕", "–")
"""Of the states."""
MOST_ACROSS = 30
"""Experiments side by side of a settings level, and twice as many of all levels; more would leave
no room for a name."""
_HEADER = alt.Header(
    labelFontSize=13,
    labelFontWeight=600,
    labelAnchor="start",
    labelColor=style.INK,
    labelOrient="top",
    labelAngle=0,
)
"""Of the tiles of a settings level."""


def matrix(table: pd.DataFrame, *, stacked: bool = False) -> Any:
    """Draw a tile for every solver and experiment by settings level, `stacked` for a narrow screen.

    Clicking sets `pick`. More experiments than `MOST_ACROSS` are rows instead of columns, then
    `usermeta` has `tall`.

    Parameters
    ----------
    table : columns `COLUMNS`, solvers and experiments in their order.
    """
    solvers, experiments = table["solver"].unique().tolist(), table["experiment"].unique().tolist()
    levels = table["settings"].unique().tolist()
    # Worked out in the figure, so that the page can hand it other rows.
    signs = json.dumps(dict(zip(STATES, MARKS, strict=True)), ensure_ascii=False)
    inks = json.dumps(dict(zip(STATES, style.STATE_COLOURS, strict=True)))
    pick = style.picking("id", "experiment_id")
    in_a_row = len(experiments) * (1 if stacked else len(levels))
    tall = len(experiments) > MOST_ACROSS or in_a_row > 2 * MOST_ACROSS
    across, down = ("solver", "experiment") if tall else ("experiment", "solver")
    order = {"solver": solvers, "experiment": experiments}
    above = alt.Axis(orient="top", labelAngle=-90 if stacked else -40)
    x = alt.X(f"{across}:N", sort=order[across], title=None, axis=above)
    y = alt.Y(f"{down}:N", sort=order[down], title=None)
    titles = {"experiment": "in", "verdict": "verdict"}
    titles |= {"off": "largest error_move", "fails": "failed steps", "because": "why"}
    titled = (style.tip(f"{field}:N", title) for field, title in titles.items())
    tips = ["solver:N", style.tip("call_mode:N", "call mode"), "settings:N", *titled]
    base = (
        alt.Chart()
        .transform_calculate(
            off="isValid(datum.error) ? format(datum.error, '.2~g') : '–'",
            fails="isValid(datum.failed) ? datum.failed : '–'",
            because="datum.detail || '–'",
        )
        .encode(x=x, y=y, tooltip=tips)
    )
    # One below the other the tiles are narrower than three words side by side.
    legend: dict[str, Any] = {
        "symbolType": "square",
        "labelExpr": f"{signs}[datum.label] + ' ' + datum.label",
    }
    legend |= {"columns": 2} if stacked else {}
    tiles = base.mark_rect(strokeWidth=1.5, stroke=style.PAPER).encode(
        color=style.coloured("verdict", STATES, style.FILLS, title="verdict", **legend)
    )
    # Above all tiles, or those beside it would cover half of its frame.
    frame: dict[str, Any] = {"filled": False, "strokeWidth": 3, "aria": False}
    chosen = base.transform_filter(pick).mark_rect(stroke=style.ACCENT, **frame)
    signed = base.transform_calculate(sign=f"{signs}[datum.verdict]", ink=f"{inks}[datum.verdict]")
    text = signed.mark_text(fontSize=12, fontWeight=600)
    text = text.encode(text="sign:N", color=alt.Color("ink:N", scale=None))
    size: dict[str, Any] = {"width": alt.Step(30), "height": alt.Step(15 if tall else 22)}
    placed = alt.layer(tiles.add_params(pick), text, chosen, data=table, **size)
    own: dict[str, Any] = {"sort": levels, "title": None, "header": _HEADER}
    if stacked:
        chart = placed.facet(row=alt.Row("settings:N", **own), spacing=14)
        chart = chart.resolve_axis(x="independent")
    else:
        chart = placed.facet(column=alt.Column("settings:N", **own), spacing=14)
    chart.usermeta = {"tall": tall}
    states = "pass, borderline, inconclusive, late, fail or not run"
    about = f"Tiles of solver by scenario: {states}, for each settings level."
    return style.styled(chart, "Verdicts by scenario and replay", about)
