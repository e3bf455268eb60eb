"""Solvers over their releases as a page: one file without a script.

What a step takes with each version, and how wrong it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.compare.releases import FIGURES, release_table
from dpbench.files.writing import write_given
from dpbench.report.charts import style
from dpbench.report.compare.releases import Releases
from dpbench.report.formats import MISSING
from dpbench.report.page.write import drawn, rendered

AGES = {0: "newest release", 1: "earlier release"}
_WIDTH = 260
"""Narrow enough for a telephone, names included."""
MOST_PANELS = 4
"""So many problems are drawn; all of them are in the tables."""


def write_releases(path: Path, releases: Releases) -> Path:
    """Write the page: it needs no script and nothing beside it."""
    table = release_table(releases.histories, MOST_PANELS)
    table["age"] = table["age"].map(AGES)
    unit = f"× {releases.histories.reference}" if releases.histories.reference else "µs"
    charts = {
        "Point p50, bar to p99 where 1000 steps support one, line to the largest step; replays, "
        "the most usual configuration of each solver.": release_times(table, unit),
        "The same runs; dashed: what the demand allows. An error of exactly 0 has no point.": (
            release_errors(table, releases.demand.error_move)
        ),
    }
    figures = [(caption, drawn(chart)) for caption, chart in charts.items() if len(table)]
    text = rendered(
        "releases",
        lead=releases.lead,
        lines=releases.lines,
        figures=figures,
        tables=[table for table in releases.tables if table.rows],
        missing=MISSING,
    )
    write_given(path, text.encode())
    return path


def release_times(table: pd.DataFrame, unit: str) -> Any:
    """A row per version: point p50, bar to p99, line to the largest step; a panel per problem.

    Parameters
    ----------
    table : of `release_table`, age in words, the first row on top; unit : of the times.
    """
    base = _base(table)
    x = alt.X("p50:Q", title=f"step time [{unit}]", scale=style.log_scale(), axis=_axis("~g"))
    line = base.mark_rule(strokeWidth=2).encode(x=x, x2="largest:Q")
    known = base.transform_filter("isValid(datum.p99)")
    bar = known.mark_rule(strokeWidth=8).encode(x=x, x2="p99:Q")
    layers = (line, bar, _point(base, x))
    return _panels(layers, "Step time", "Step times of each solver, version by version.")


def release_errors(table: pd.DataFrame, allowed: float) -> Any:
    """A row per version: the largest error of the first move, against what the demand allows.

    Parameters
    ----------
    table : as of `release_times`; an error of 0 or none at all has no point.
    """
    title = "largest error of the first move [rate-limit steps]"
    x = alt.X("error:Q", title=title, scale=style.log_scale(), axis=_axis(".0e"))
    drawn = _base(table).transform_filter("isFinite(datum.error) && datum.error > 0")
    limit = alt.Chart(table).transform_calculate(limit=f"{allowed}")
    rule = limit.mark_rule(strokeDash=[4, 3], color=style.MISSES).encode(x="limit:Q")
    layers = (rule, _point(drawn, x))
    return _panels(layers, "Error", "Largest error of each solver, version by version.")


def _axis(form: str) -> alt.Axis:
    return alt.Axis(format=form, tickCount=5, labelOverlap="greedy", labelSeparation=6)


def _base(table: pd.DataFrame) -> Any:
    return alt.Chart(table).encode(
        y=style.named_rows("label", list(dict.fromkeys(table["label"])), labelLimit=170),
        color=style.coloured("age", AGES.values(), (style.ACCENT, style.NOT_RUN)),
        shape=alt.Shape("age:N", scale=style.names_scale(AGES.values(), ("circle", "diamond"))),
        tooltip=["label:N", *(style.tip(f"{name}:Q") for name in FIGURES)],
    )


def _point(base: Any, x: alt.X) -> Any:
    return base.mark_point(filled=True, size=60, opacity=1).encode(x=x)


def _panels(layers: Sequence[Any], title: str, description: str) -> Any:
    chart = alt.layer(*layers, width=_WIDTH, height=alt.Step(20))
    header = alt.Header(title=None, labelAnchor="start", labelOrient="top", labelFontSize=12)
    row = alt.Row("problem:N", title=None, header=header, sort=None)
    return style.styled(chart.facet(row=row).resolve_scale(y="independent"), title, description)
