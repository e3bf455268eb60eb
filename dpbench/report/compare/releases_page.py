"""Solvers over their releases as a page: one file without a script."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
from markupsafe import Markup

from dpbench.analysis.compare.releases import Histories, History, Release
from dpbench.report.charts.render import svg
from dpbench.report.compare.releases import Releases
from dpbench.report.compare.releases_chart import AGES, COLUMNS, release_errors, release_times
from dpbench.report.formats import MISSING
from dpbench.report.page.write import environment, follow, own

MOST_PANELS = 4
"""So many problems are drawn; all of them are in the tables."""


def write_releases(path: Path, releases: Releases) -> Path:
    """Write the page: it needs no script and nothing beside it."""
    table = _chart_table(releases.histories)
    unit = f"× {releases.histories.reference}" if releases.histories.reference else "µs"
    charts = {
        "Point p50, bar to p99 where 1000 steps support one, line to the largest step; replays, "
        "the most usual configuration of each solver.": release_times(table, unit),
        "The same runs; dashed: what the demand allows. An error of exactly 0 has no point.": (
            release_errors(table, releases.demand.error_move)
        ),
    }
    text = (
        environment()
        .get_template("releases.html.j2")
        .render(
            css=Markup(own("templates/page.css")),
            lead=releases.lead,
            lines=releases.lines,
            figures=[
                (caption, Markup(follow(svg(chart, titled=False))))
                for caption, chart in charts.items()
                if len(table)
            ],
            tables=[table for table in releases.tables if table.rows],
            missing=MISSING,
        )
    )
    path.write_text(text, encoding="utf-8")
    return path


def _chart_table(histories: Histories) -> pd.DataFrame:
    """Columns `COLUMNS`: of each solver its most usual configuration on each replayed problem."""
    drawn: dict[tuple[str, str], History] = {}
    for history in sorted(histories.all, key=lambda history: not history.changed):
        if history.run.mode == "replay" and math.isfinite(history.releases[0].p50):
            drawn.setdefault((history.run.problem, history.run.solver), history)
    problems = list(dict.fromkeys(problem for problem, _ in drawn))[:MOST_PANELS]
    scale = 1.0 if histories.reference else 1e-3
    rows = [
        _chart_row(history, i, release, scale)
        for (problem, _), history in drawn.items()
        if problem in problems
        for i, release in enumerate(history.releases)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _chart_row(history: History, i: int, release: Release, scale: float) -> tuple[object, ...]:
    age = AGES[0] if i == len(history.releases) - 1 else AGES[1]
    times = (scale * time for time in (release.p50, release.p99, release.largest))
    label = f"{history.run.solver} {release.version}"
    return label, age, history.run.problem, *times, release.error_move
