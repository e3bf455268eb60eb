"""A comparison as a page, in the style of the report: one file, one chosen configuration, kept in
the address."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np

from dpbench.analysis.compare.ratio_table import claims_first, furthest, ratio_table
from dpbench.analysis.compare.times import Compared, Timing
from dpbench.files.writing import write_given
from dpbench.report.charts.pairs import pairs
from dpbench.report.charts.style import ROW_STEP
from dpbench.report.compare.comparison import Comparison
from dpbench.report.compare.tables import answer_line, shared_line, times_table
from dpbench.report.compare.times_chart import both, ratios
from dpbench.report.formats import interval_text, plural, unmarked
from dpbench.report.page.facts import columns_of
from dpbench.report.page.pack import Block
from dpbench.report.page.write import drawn, own, rendered, specification
from dpbench.report.table import Table

SHOWN = 12
"""So many of the slowest and of the fastest are drawn whatever is said of them; all of them are in
the table below."""
MOST_ROWS = 40
"""So many rows of a table stand on the page before any script has run."""
LEFT_OUT = ("B/A", "steps × rounds")
"""Columns of the table of times that the page has no room for."""


def write_comparison(path: Path, comparison: Comparison) -> Path:
    """Write the page of a comparison."""
    order = claims_first(comparison.compared)
    charts = _charts(order, comparison.margin)
    times = _times(order, comparison) if order else None
    text = rendered(
        "compare",
        [own(f"scripts/{name}.js") for name in ("common", "compare")],
        verdict="worse somewhere" if comparison.worse else "no regression shown",
        lead=lead(comparison),
        lines=[unmarked(line) for line in comparison.lines],
        figures={name: drawn(chart) for name, chart in charts.items() if name != "steps"},
        left_out=len(order) - len(furthest(ratio_table(order), SHOWN)) if order else 0,
        times=times,
        tables=[replace(t, shown=MOST_ROWS) for t in comparison.tables if not _is_times(t)],
        block="" if times is None else _block(order, charts, times),
    )
    write_given(path, text.encode())
    return path


def _charts(order: Sequence[Compared], margin: float) -> dict[str, Any]:
    if not order:
        return {}
    table = ratio_table(order)
    return {
        "ratios": ratios(furthest(table, SHOWN), margin),
        "both": both(table),
        "steps": pairs("A: step time", "B: step time"),
    }


def _is_times(table: Table) -> bool:
    return "B/A less machine" in table.heads


def _times(order: Sequence[Compared], comparison: Comparison) -> Table:
    """The table of times in the order of the page, without `LEFT_OUT`."""
    c = comparison
    whole = times_table(order, c.margin, c.alpha, ordered=True, reference=c.reference)
    kept = [i for i, head in enumerate(whole.heads) if head not in LEFT_OUT]
    heads, *rows = (tuple(row[i] for i in kept) for row in (whole.heads, *whole.rows))
    return replace(whole, heads=heads, rows=tuple(rows), shown=MOST_ROWS)


def _block(order: Sequence[Compared], charts: dict[str, Any], times: Table) -> str:
    """The data of the page: every configuration with its steps, and the figures."""
    block, addresses = Block(), _addresses(order)
    cells_of = replace(times, shown=None).page_rows
    rows = [
        {
            "name": one.timing.pair.a.configuration.label,
            "where": one.timing.pair.a.problem,
            "address": address,
            "said": said(one),
            "cells": cells,
            **_steps(block, one.timing),
        }
        for one, address, cells in zip(order, addresses, cells_of, strict=True)
    ]
    document = {
        "compared": columns_of(rows),
        "heads": list(times.heads),
        "row_step": ROW_STEP,
        "charts": {name: specification(chart) for name, chart in charts.items()},
    }
    return block.text(document)


def _steps(block: Block, timing: Timing) -> dict[str, int | None]:
    """Both times of each step, element 0 for step `first`; nothing of a folder without steps."""
    if not len(timing.k):
        return {"first": 0, "a": None, "b": None}
    first = int(timing.k[0])
    times = np.full((2, int(timing.k[-1]) - first + 1), np.nan)
    times[:, timing.k - first] = timing.a_ns, timing.b_ns
    return {"first": first, "a": block.log(times[0]), "b": block.log(times[1])}


def _addresses(order: Sequence[Compared]) -> list[str]:
    """The fragment that chooses each, named as on the page of a run; of several alike, numbered."""
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


def lead(comparison: Comparison) -> list[str]:
    """One sentence on times and accuracy, then what all configurations became slower by."""
    together = [
        unmarked(f"All together: {shared_line(shared)}.")
        for shared in comparison.shared
        if shared.assessment is not None and shared.assessment.verdict == "slower"
    ]
    return [unmarked(f"{_slower(comparison)} {_worse(comparison)}"), *together]


def said(one: Compared) -> str:
    """The verdict on one configuration with its figures."""
    assessment, timing = one.assessment, one.timing
    interval = interval_text(assessment.ratio.low, assessment.ratio.high)
    return (
        f"B takes {assessment.ratio.value:.3f} times as long as A, the machine's factor "
        f"{assessment.machine:.3f} taken out (interval {interval}, {plural(timing.steps, 'step')}, "
        f"{plural(timing.rounds, 'round')}): {assessment.verdict}."
    )


def _slower(comparison: Comparison) -> str:
    slower = [c for c in comparison.compared if c.assessment.verdict == "slower"]
    count = len(comparison.compared)
    if not count:
        return "No step times to compare."
    if not slower:
        return f"None of {plural(count, 'configuration')} is shown to be slower."
    first = max(slower, key=lambda c: c.assessment.ratio.value)
    pair, ratio = first.timing.pair, first.assessment.ratio
    return (
        f"Slower: {len(slower)} of {plural(count, 'configuration')}, most of all {pair.label} on "
        f"{pair.a.problem}, {ratio.value:.2f} times as long (interval "
        f"{interval_text(ratio.low, ratio.high)}, machine factor "
        f"{first.assessment.machine:.2f} taken out)."
    )


def _worse(comparison: Comparison) -> str:
    worse = [answer for answer in comparison.figures if answer.change == "worse"]
    count = len(comparison.figures)
    if not worse:
        return f"No figure of accuracy or control of {count} is worse." if count else ""
    return f"Worse: {len(worse)} of {plural(count, 'figure')}, first {answer_line(worse[0])}."
