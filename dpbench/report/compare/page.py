"""Comparison of two result folders as a page: one file with one selection in the address."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import altair as alt
import numpy as np
import pandas as pd

from dpbench.analysis.compare.times import ComparedTimes, Timing
from dpbench.files.regular_files import write_bytes_to_file_or_pipe
from dpbench.report.charts import style
from dpbench.report.charts.steps import draw_step_pairs
from dpbench.report.charts.style import ROW_STEP
from dpbench.report.compare.comparison import (
    Comparison,
    describe_change,
    describe_changes_in_si_units,
    describe_shared_factor,
    list_metrics_in_verdicts,
    make_times_table,
)
from dpbench.report.compare.folders import describe_changed_options
from dpbench.report.formats import Table, format_interval, plural, strip_markdown
from dpbench.report.page.data import convert_rows_to_columns
from dpbench.report.page.pack import Block
from dpbench.report.page.write import (
    compile_vega_in_page_colours,
    read_page_file,
    render_figure_markup,
    render_page,
)

SHOWN = 12
"""Number of the slowest and of the fastest in the figure; the table has all."""
MOST_ROWS = 40
"""Rows of a table on the page before any script has run."""
LEFT_OUT = ("B/A", "steps × rounds")
"""Columns of the table of times without room on the page."""


def write_comparison(path: Path, comparison: Comparison) -> Path:
    """Write the page that compares two result folders, as one HTML file; return its path."""
    order = sort_claims_first(comparison.compared)
    charts, times, left_out = dict[str, Any](), None, 0
    if order:
        table = make_ratio_table(order)
        furthest, times = select_furthest_rows(table, SHOWN), _page_times_table(order, comparison)
        left_out = len(order) - len(furthest)
        charts = {
            "ratios": draw_ratios(furthest, comparison.margin),
            "both": draw_both_runs(table),
            "steps": draw_step_pairs("A: step time", "B: step time"),
        }
    others = [t for t in comparison.tables if "B/A without machine" not in t.heads]
    text = render_page(
        "compare",
        [read_page_file(f"scripts/{name}.js") for name in ("common", "compare")],
        verdict=comparison.headline,
        lead=make_lead_sentences(comparison),
        lines=[strip_markdown(line) for line in comparison.lines],
        figures={
            name: render_figure_markup(chart) for name, chart in charts.items() if name != "steps"
        },
        left_out=left_out,
        times=times,
        tables=[replace(t, shown=MOST_ROWS) for t in others],
        block="" if times is None else _pack_data(order, charts, times),
    )
    write_bytes_to_file_or_pipe(path, text.encode())
    return path


def _page_times_table(order: Sequence[ComparedTimes], comparison: Comparison) -> Table:
    """Return the table of compared step times as on the page, without two wide columns."""
    c = comparison
    whole = make_times_table(order, c.margin, c.alpha, ordered=True, reference=c.reference)
    kept = [i for i, head in enumerate(whole.heads) if head not in LEFT_OUT]
    heads, *rows = (tuple(row[i] for i in kept) for row in (whole.heads, *whole.rows))
    return replace(whole, heads=heads, rows=tuple(rows), shown=MOST_ROWS)


def _pack_data(order: Sequence[ComparedTimes], charts: dict[str, Any], times: Table) -> str:
    """Return the compared step times packed as text for the script of a comparison's page."""
    block, addresses = Block(), _make_selection_addresses(order)
    cells_of = replace(times, shown=None).page_rows
    rows = [
        {
            "name": one.timing.pair.a.configuration.label,
            "where": one.timing.pair.a.problem,
            "address": address,
            "said": describe_verdict(one),
            "cells": cells,
            **_pack_step_times(block, one.timing),
        }
        for one, address, cells in zip(order, addresses, cells_of, strict=True)
    ]
    document = {
        "compared": convert_rows_to_columns(rows),
        "heads": list(times.heads),
        "row_step": ROW_STEP,
        "charts": {name: compile_vega_in_page_colours(chart) for name, chart in charts.items()},
    }
    return block.compress_to_base64(document)


def _pack_step_times(block: Block, timing: Timing) -> dict[str, int | None]:
    """Add the times of each step in runs A and B to the page's packed arrays; return indices."""
    if not len(timing.k):
        return {"first": 0, "a": None, "b": None}
    first = int(timing.k[0])
    times = np.full((2, int(timing.k[-1]) - first + 1), np.nan)
    times[:, timing.k - first] = timing.a_ns, timing.b_ns
    return {
        "first": first,
        "a": block.add_as_uint16_logs(times[0]),
        "b": block.add_as_uint16_logs(times[1]),
    }


def _make_selection_addresses(order: Sequence[ComparedTimes]) -> list[str]:
    """Return, for each compared configuration, the URL fragment that selects it on the page."""
    seen: dict[str, int] = {}
    addresses = []
    for one in order:
        run = one.timing.pair.a
        parts = {
            "s": run.solver,
            "w": f"{run.route}-{run.policy}",
            "set": run.settings,
            "sc": run.problem,
        }
        address = urlencode(parts)
        seen[address] = seen.get(address, 0) + 1
        addresses.append(address if seen[address] == 1 else f"{address}&n={seen[address]}")
    return addresses


def make_lead_sentences(comparison: Comparison) -> list[str]:
    """Return sentences on a comparison of two runs: step times, accuracy, shared changes."""
    together = [
        strip_markdown(f"Shared change: {describe_shared_factor(shared)}.")
        for shared in comparison.shared
        if shared.assessment is not None and shared.assessment.verdict == "slower"
    ]
    counted = list_metrics_in_verdicts(comparison.figures)
    worse, count = [answer for answer in counted if answer.change == "worse"], len(counted)
    figures = (
        f"None of {plural(count, 'metric')} of accuracy and control is worse." if count else ""
    )
    if worse:
        figures = (
            f"Worse: {len(worse)} of {plural(count, 'metric')}, first {describe_change(worse[0])}."
        )
    changed = [
        f"{line[0].upper()}{line[1:]}." for line in describe_changed_options(comparison.pairs)
    ]
    of_si = describe_changes_in_si_units([f for f in comparison.figures if f.change == "worse"])
    si = [f"{line[0].upper()}{line[1:]}." for line in of_si]
    return [*changed, strip_markdown(f"{_describe_slower(comparison)} {figures}"), *si, *together]


def describe_verdict(one: ComparedTimes) -> str:
    """Return a sentence with the verdict on a configuration's step time ratio, and its interval."""
    assessment, timing = one.assessment, one.timing
    interval = format_interval(assessment.ratio.low, assessment.ratio.high)
    if assessment.verdict == "not judged":
        return (
            f"B takes {assessment.raw:.3f} times as long as A ({plural(timing.steps, 'step')}, "
            f"{plural(timing.rounds, 'round')}); the machine's factor is unknown: not judged."
        )
    return (
        f"B takes {assessment.ratio.value:.3f} times as long as A, the machine's factor "
        f"{assessment.machine:.3f} taken out (interval {interval}, {plural(timing.steps, 'step')}, "
        f"{plural(timing.rounds, 'round')}): {assessment.verdict}."
    )


def _describe_slower(comparison: Comparison) -> str:
    """Return a sentence on how many configurations are slower in B, and which one most."""
    slower = [c for c in comparison.compared if c.assessment.verdict == "slower"]
    count = len(comparison.compared)
    if not count:
        return "No step times to compare."
    if not slower:
        return f"None of {plural(count, 'configuration')} is shown to be slower."
    first = max(slower, key=lambda c: c.assessment.ratio.value)
    pair, ratio = first.timing.pair, first.assessment.ratio
    return (
        f"Slower: {len(slower)} of {plural(count, 'configuration')}, most of all "
        f"{pair.configuration_label} on {pair.a.problem}, {ratio.value:.2f} times as long "
        f"(interval {format_interval(ratio.low, ratio.high)}, machine factor "
        f"{first.assessment.machine:.2f} taken out)."
    )


VERDICTS = (
    *("slower", "faster", "faster, not all verified"),
    *("equivalent", "no difference shown", "machine disturbed", "not judged"),
)
_COLOUR = style.colour(
    "verdict",
    VERDICTS,
    (style.FAIL, style.PASS, style.INCONCLUSIVE, style.SOFT, *[style.NOT_RUN] * 3),
    columns=2,
)
_SHAPES = style.names_scale(
    VERDICTS, ("triangle-right", "triangle-left", "diamond", "circle", "square", "stroke", "cross")
)
_SHAPE = alt.Shape("verdict:N", scale=_SHAPES, title=None)
_TIPS = [
    style.tooltip("name:N", "configuration"),
    "verdict:N",
    *(style.tooltip(f"{name}:Q") for name in ("ratio", "low", "high")),
    style.tooltip("a_us:Q", "A [µs]"),
    style.tooltip("b_us:Q", "B [µs]"),
]


def draw_ratios(table: pd.DataFrame, margin: float) -> Any:
    """Return a chart of the step time ratio B/A of each configuration with its interval.

    table : of `make_ratio_table`; margin : ratio that counts as equal.
    """
    base = alt.Chart(table).encode(
        y=alt.Y("name:N", sort=table["name"].tolist(), title=None, axis=style.row_name_axis(330)),
        color=_COLOUR,
        tooltip=_TIPS,
    )
    pick = style.pick_selection("id")
    rows = style.draw_whole_rows(base, style.value_if(pick, 0.16, 0.0), 16, color=style.ACCENT)
    rows = rows.encode(color=alt.value(style.ACCENT)).add_params(style.narrow_flag(), pick)
    axis = alt.Axis(orient="top", format="~g", labelOverlap="greedy")
    title = "B / A, machine factor taken out"
    x = alt.X("ratio:Q", title=title, scale=style.log_scale(), axis=axis)
    spans = base.mark_rule(strokeWidth=1.5).encode(x=alt.X("low:Q"), x2=alt.X2("high:Q"))
    points = base.mark_point(filled=True, size=60, opacity=1).encode(x=x, shape=_SHAPE)
    edges = pd.DataFrame({"edge": [1.0 / (1.0 + margin), 1.0, 1.0 + margin]})
    rules = alt.Chart(edges).mark_rule(color=style.INK, strokeDash=[2, 3]).encode(x=alt.X("edge:Q"))
    chart = alt.layer(rows, rules, spans, points, width=430, height=alt.Step(17))
    return style.set_style(
        chart, "Slower configurations", "Ratio of step times of each configuration."
    )


def draw_both_runs(table: pd.DataFrame) -> Any:
    """Return a chart of the median step time in B against that in A, a mark per configuration."""
    low = 0.8 * float(table[["a_us", "b_us"]].min().min())
    high = 1.25 * float(table[["a_us", "b_us"]].max().max())
    scale = style.log_scale(domain=[low, high])
    x = alt.X("a_us:Q", title="A: median step time [µs]", scale=scale)
    y = alt.Y("b_us:Q", title="B: median step time [µs]", scale=scale)
    pick = style.pick_selection("id")
    points = alt.Chart(table).mark_point(filled=True, opacity=0.9)
    looks: dict[str, Any] = {"color": _COLOUR, "shape": _SHAPE, "tooltip": _TIPS}
    points = points.encode(x=x, y=y, **looks, size=style.value_if(pick, 260, 55)).add_params(pick)
    chart = alt.layer(style.draw_equality_line(low, high, x, y), points, width=330, height=330)
    return style.set_style(chart, "Both runs", "Median step times of both runs against each other.")


def sort_claims_first(compared: Sequence[ComparedTimes]) -> list[ComparedTimes]:
    """Return compared step times sorted: slower, faster, then undecided, each by ratio."""
    rank = {"slower": 0, "faster": 1}
    return sorted(
        compared, key=lambda c: (rank.get(c.assessment.verdict, 2), -c.assessment.ratio.value)
    )


def make_ratio_table(compared: Sequence[ComparedTimes]) -> pd.DataFrame:
    """Return a table of step time ratios B/A by configuration, the largest ratio first."""
    rows = [
        {
            "id": str(i),
            "name": f"{one.timing.pair.a.configuration.label}, {one.timing.pair.a.sequence}",
            "ratio": one.assessment.ratio.value,
            "low": one.assessment.ratio.low,
            "high": one.assessment.ratio.high,
            "verdict": one.assessment.verdict,
            "a_us": one.timing.median_ns[0] / 1e3,
            "b_us": one.timing.median_ns[1] / 1e3,
            "sequence": one.timing.pair.a.sequence,
        }
        for i, one in enumerate(compared)
    ]
    return pd.DataFrame(rows).sort_values("ratio", ascending=False, kind="stable")


def select_furthest_rows(table: pd.DataFrame, ends: int) -> pd.DataFrame:
    """Return the rows of a table of time ratios that are judged to differ, or at both ends."""
    judged = table["verdict"].isin(("slower", "faster"))
    place = pd.Series(range(len(table)), index=table.index)
    return table[judged | (place < ends) | (place >= len(table) - ends)]
