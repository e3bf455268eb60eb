"""What accuracy costs: time against the error that was reached, a line a solver."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts import style

COLUMNS = (
    *("id", "solver", "family", "settings", "route", "policy"),
    *("error", "p50_us", "p99_us", "verdict"),
)
FULL = {"pass": 0.95, "borderline": 0.6, "inconclusive": 0.3, "late": 0.0, "fail": 0.0}
"""How full a point is, by what is said of its configuration."""
_LEGEND = {"pass": style.INK, "inconclusive": style.LINE, "late or fail": style.PAPER}
_COLUMNS = alt.ExprRef("narrow ? 1 : 3")
"""Of each legend: three of them stand side by side on a phone."""
_FIGURES = (
    "verdict:N",
    style.tip("error:Q", digits=2),
    style.tip("p50_us:Q", "p50 [µs]"),
    style.tip("p99_us:Q", "p99 [µs]"),
)


def accuracy(table: pd.DataFrame, error_limit: float) -> Any:
    """Draw step time against largest error; lines join the settings of a solver.

    Points are filled as `FULL` says; clicking sets `pick`; `percentile` is p50 or p99.

    Parameters
    ----------
    table : columns `COLUMNS`, errors finite; error_limit : drawn as a line.
    """
    table = table.assign(
        shown=table["error"].clip(lower=style.FLOOR),
        full=[FULL.get(state, FULL["inconclusive"]) for state in table["verdict"]],
    )
    percentile = alt.param(name="percentile", value="p50")
    pick = style.picking("id")
    families = {f: hue for f, hue in style.FAMILY_COLOURS.items() if f in set(table["family"])}
    colour = style.coloured(
        "family", families, families.values(), columns=_COLUMNS, symbolOpacity=1.0
    )
    decades = alt.Axis(format=".0e")
    apart = style.log_scale(padding=12)  # room for the name of a point in the corner
    base = (
        alt.Chart(table)
        .transform_calculate(time="percentile == 'p99' ? datum.p99_us : datum.p50_us")
        .transform_filter("isValid(datum.time)")
        .encode(
            x=alt.X("time:Q", title="step time [µs], log scale", scale=apart),
            y=alt.Y("shown:Q", title="largest error_move", scale=apart, axis=decades),
            color=colour,
            detail="solver:N",
            tooltip=["solver:N", "settings:N", "route:N", "policy:N", *_FIGURES],
        )
    )
    lines = base.mark_line(strokeWidth=1, opacity=0.45).add_params(percentile, style.narrow(), pick)
    filled = style.below(columns=_COLUMNS, symbolFillColor=style.INK, symbolOpacity=1.0)
    dots = base.mark_point(filled=True, strokeWidth=1.5).encode(
        stroke=alt.Stroke(
            "family:N", scale=style.names_scale(families, families.values()), legend=None
        ),
        fillOpacity=alt.FillOpacity("full:Q", scale=None, legend=None),
        shape=alt.Shape("settings:N", title=None, legend=filled),
        size=style.either(pick, 190, 70),
    )
    named = (
        base.transform_window(rank="row_number()", groupby=["solver"], sort=[{"field": "shown"}])
        .transform_filter("datum.rank == 1")
        .mark_point(filled=True, opacity=0, size=110)
        .properties(name=style.NAMES)
    )
    return style.styled(
        alt.layer(
            lines, style.limit_rule(error_limit), dots, named, _fullness(), width=620, height=360
        ),
        "Accuracy against time",
        "Largest error of the first move against step time, a point for each settings level.",
    )


def _fullness() -> Any:
    """Draw the legend of the filling from invisible points: Vega has none of its own."""
    scale = style.names_scale(_LEGEND, _LEGEND.values())
    looks_of: dict[str, Any] = {"symbolType": "circle", "symbolStrokeColor": style.INK}
    legend = style.below(columns=_COLUMNS, symbolStrokeWidth=1.5, **looks_of)
    unseen = style.inline(*({"look": look} for look in _LEGEND)).mark_point(
        filled=True, size=0, opacity=0, aria=False
    )
    return unseen.encode(fill=alt.Fill("look:N", scale=scale, title="verdict", legend=legend))
