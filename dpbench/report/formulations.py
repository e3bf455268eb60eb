"""Formulations side by side: every other part of the report keeps to the common one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.statistics import paired_ratio
from dpbench.analysis.step_times import StepTimes
from dpbench.analysis.times.pairs import paired
from dpbench.bench.record.configuration import COMMON
from dpbench.report.formats import MISSING, interval_text, micro_text, plural, significant
from dpbench.report.table import Cell, Mark, Table, row_of

PooledConfiguration = dict[str, RunRecord]
"""The rows of one solver, route, policy and settings by formulation."""

OTHERS = (
    "Formulations of one and the same problem were replayed side by side: condensed box (the moves "
    "alone, limits two-sided), condensed stacked (the same with one-sided rows, the paper's "
    "eq. 23-25) and sparse (states kept, ordered by stages). Every other table, figure and verdict "
    "of this report keeps to the common one, condensed box where it was run."
)


def formulation_tables(view: Records, demand: Demand) -> list[Table]:
    """A table per replayed sequence and units in which more than one formulation was run."""
    groups: dict[tuple[str, str], list[RunRecord]] = {}
    for row in view.all_runs:
        if row.mode == "replay" and not row.family and not row.is_baseline_law:
            groups.setdefault((row.sequence, row.units), []).append(row)
    tables = []
    for (sequence, units), rows in groups.items():
        names = sorted({row.formulation for row in rows}, key=lambda name: (name != COMMON, name))
        if len(names) > 1:
            tables.append(_table(view, sequence, units, rows, names, demand))
    return tables


def _table(
    view: Records,
    sequence: str,
    units: str,
    rows: Sequence[RunRecord],
    names: Sequence[str],
    demand: Demand,
) -> Table:
    configurations: dict[tuple[str, ...], PooledConfiguration] = {}
    for row in rows:
        key = tuple(str(getattr(row, name)) for name in ("solver", "route", "policy", "settings"))
        configurations.setdefault(key, {})[row.formulation] = row
    several = {
        key: configuration
        for key, configuration in configurations.items()
        if len(configuration) > 1
    }
    times = {key: _timed(view, configuration) for key, configuration in several.items()}
    best = {key: _best(configuration, times[key], demand) for key, configuration in several.items()}
    # Ratios that are taken, whose intervals are to hold together.
    count = sum(best[key] not in ("", COMMON) and COMMON in times[key] for key in several)
    order = sorted(several, key=lambda key: (_fastest(times[key], best[key]), key))
    return Table(
        title=f"Formulations in the replay of `{sequence}`{', SI units' if units == 'si' else ''}",
        note=_note(len(order), count),
        heads=(
            "solver",
            "route",
            "policy",
            "settings",
            "best formulation",
            *(f"{name.replace('_', ' ')} [µs]" for name in names),
            "common over best",
            "interval",
        ),
        rows=tuple(
            row_of(
                *key,
                best[key].replace("_", " ") or MISSING,
                *(_median(several[key].get(name), times[key].get(name), demand) for name in names),
                *_ratio(times[key], best[key], count),
            )
            for key in order
        ),
        text_columns=5,
    )


def _note(configurations: int, ratios: int) -> str:
    """What the numbers of a table are."""
    return (
        f"{plural(configurations, 'configuration')} run in more than one formulation, the "
        "fastest first; p50 "
        "of the algorithmic step time in µs, tinted where an answer misses the demand or a "
        "step was never done. Best: the fastest by median whose answers meet the demand. "
        "Common over best: geometric mean over paired steps, above 1 where the best "
        "formulation is faster than condensed box, "
        f"with intervals that hold for all {plural(ratios, 'ratio')} together at 95 %. Making "
        "the steps is not timed in a replay."
    )


def _timed(view: Records, configuration: PooledConfiguration) -> dict[str, StepTimes]:
    found = {name: view.times(row) for name, row in configuration.items()}
    return {name: times for name, times in found.items() if times is not None}


def _best(configuration: PooledConfiguration, times: dict[str, StepTimes], demand: Demand) -> str:
    """The fastest formulation by median whose answers meet the demand; "" without one."""
    right = [name for name in times if is_right(configuration[name], demand)]
    return min(right, key=lambda name: float(np.median(times[name].algo_ns)), default="")


def _fastest(times: dict[str, StepTimes], best: str) -> float:
    return float(np.median(times[best].algo_ns)) if best else np.inf


def _median(row: RunRecord | None, times: StepTimes | None, demand: Demand) -> Cell:
    if row is None:
        return Cell(MISSING, "quiet")
    if times is None:
        return Cell(row.outcome.replace("_", " "), "quiet")
    text = micro_text(float(np.median(times.algo_ns)))
    return Cell(text, "" if is_right(row, demand) else "bad")


def _ratio(times: dict[str, StepTimes], best: str, count: int) -> tuple[Cell, Cell]:
    """Common over best, and its interval."""
    if not best or COMMON not in times:
        return Cell(MISSING, "quiet"), Cell(MISSING, "quiet")
    if best == COMMON:
        return Cell("1", "quiet"), Cell(MISSING, "quiet")
    found = paired_ratio(*paired(times[COMMON], times[best]), comparisons=count)
    mark: Mark = "quiet" if found.spans(1.0) else "good" if found.value > 1.0 else "bad"
    return Cell(significant(found.value), mark), Cell(interval_text(found.low, found.high), "quiet")
