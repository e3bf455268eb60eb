"""A comparison as a page, in the style of the report: one file, its figures as SVG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from dpbench.report.charts.compared import COLUMNS, both, ratios
from dpbench.report.charts.render import svg
from dpbench.report.compare.comparison import Comparison
from dpbench.report.page.write import environment, follow, own

SHOWN = 12
"""So many of the slowest and of the fastest are drawn whatever is said of them."""


def write_comparison(path: Path, comparison: Comparison) -> Path:
    """Write the page of a comparison."""
    table = _table(comparison)
    figures = []
    if len(table):
        drawn = (
            ("Both runs", both(table)),
            ("What became slower or faster", ratios(_furthest(table), comparison.margin)),
        )
        figures = [
            {"title": title, "svg": Markup(follow(svg(chart, titled=False)))}
            for title, chart in drawn
        ]
    text = (
        environment()
        .get_template("compare.html.j2")
        .render(
            css=Markup(own("page.css")),
            verdict="worse somewhere" if comparison.worse else "no regression shown",
            lines=[line.replace("`", "") for line in comparison.lines],
            figures=figures,
            tables=[_small(t) for t in comparison.tables],
        )
    )
    path.write_text(text, encoding="utf-8")
    return path


def _table(comparison: Comparison) -> pd.DataFrame:
    rows = [
        (
            f"{one.timing.pair.a.configuration.label}, {one.timing.pair.a.sequence}",
            one.assessment.ratio.value,
            one.assessment.ratio.low,
            one.assessment.ratio.high,
            one.assessment.verdict,
            one.timing.pair.a.algo_p50_ns / 1e3,
            one.timing.pair.b.algo_p50_ns / 1e3,
            one.timing.pair.a.sequence,
        )
        for one in comparison.compared
    ]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    return table.sort_values("ratio", ascending=False, kind="stable")


def _furthest(table: pd.DataFrame) -> pd.DataFrame:
    """What is judged to differ, and else the ends of the list; all of it is in the table below."""
    judged = table["verdict"].isin(("slower", "faster"))
    place = pd.Series(range(len(table)), index=table.index)
    return table[judged | (place < SHOWN) | (place >= len(table) - SHOWN)]


def _small(table: Any) -> dict[str, Any]:
    rows = [[cell.text.replace("`", "") for cell in row] for row in table.rows]
    return {"title": table.title, "head": table.heads, "rows": rows, "count": len(rows)}
