"""Further tables of a comparison: changed verdicts, windows, two settings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.compare.pairs import Pair
from dpbench.analysis.compare.verdicts import VerdictChange
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_steps import StepTimes
from dpbench.analysis.times.paired_times import (
    MACHINE_DISTURBED,
    UNSTABLE,
    PairedComparison,
    compare_settings_of_solvers,
    match_times_by_step,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.time_findings import compute_p99_ns
from dpbench.report.formats import MISSING, Table, format_interval, format_microseconds
from dpbench.report.verdict.verdict_text import describe_main_reason


def make_verdicts_table(a: Records, b: Records, changes: Sequence[VerdictChange]) -> Table | None:
    """Return a table of configurations whose verdict changed from A to B; None without one."""
    if not changes:
        return None
    rows = []
    for change in changes:
        name, worse = ("B", change.b) if change.is_for_the_worse else ("A", change.a)
        rows.append(
            {
                "configuration": change.pair.configuration_label,
                "A": change.a.state,
                "B": change.b.state,
                "reason": f"{name}: {describe_main_reason(worse)}",
            }
        )
    note = (
        "The runs that both folders have are judged in each folder on their own. A verdict depends "
        "on step times, so the speed and the load of the machine can change it."
    )
    if Requirements.from_suite(a.suite) != Requirements.from_suite(b.suite):
        note += " A and B have different requirements."
    return Table.from_rows(rows, "Verdicts that changed", note=note, text_columns=4)


def make_windows_table(a: Records, b: Records, pairs: Sequence[Pair]) -> Table | None:
    """Return a table of step times in windows of two folders; None without one."""
    rows, of_medians = [], False
    for pair in pairs:
        if not (of := pair.a.steps_searched_for_hardest):
            continue
        times = a.get_step_times(pair.a), b.get_step_times(pair.b)
        if times[0] is not None and times[1] is not None:
            found = _compare_steps_of_window(pair, times[0], times[1])
        elif (recorded := _compare_columns_of_window(pair)) is not None:
            found, of_medians = recorded, True
        else:
            continue
        rows.append(
            {
                "configuration": pair.configuration_label,
                "window": pair.a.problem,
                "A p99 [µs]": format_microseconds(found.p99_ns[0]),
                "B p99 [µs]": format_microseconds(found.p99_ns[1]),
                "A largest [µs]": format_microseconds(found.largest_ns[0]),
                "B largest [µs]": format_microseconds(found.largest_ns[1]),
                "B/A": f"{found.ratio:.3f}",
                "steps": f"{found.steps} of {of}",
            }
        )
    ratio = "geometric mean over the steps of the window"
    if of_medians:
        ratio += " (the ratio of medians if a folder has no steps.parquet)"
    note = (
        "The p99 is that of all steps from which the window was chosen; with fewer than 100 "
        f"steps it is the largest. B/A: {ratio}, including the machine factor. So few "
        "steps give no interval and no verdict."
    )
    title = "Step times, windows"
    return Table.from_rows(rows, title, note=note, text_columns=2) if rows else None


@dataclass(frozen=True)
class _WindowTimes:
    """Step times of a window in A and B [ns], their ratio B/A, and the number of steps."""

    p99_ns: tuple[float, float]
    largest_ns: tuple[float, float]
    ratio: float
    steps: int


def _compare_steps_of_window(pair: Pair, a: StepTimes, b: StepTimes) -> _WindowTimes:
    """Return the times of a window from the steps that both runs completed."""
    both = match_times_by_step(a, b)
    return _WindowTimes(
        (compute_p99_ns(pair.a, a.algo_ns), compute_p99_ns(pair.a, b.algo_ns)),
        (float(both[0].max()), float(both[1].max())),
        math.exp(float(np.mean(np.log(both[1] / both[0])))),
        len(both[0]),
    )


def _compare_columns_of_window(pair: Pair) -> _WindowTimes | None:
    """Return the times of a window from columns of both runs; None if they have none."""
    runs = pair.a, pair.b
    if not all(math.isfinite(run.algo_p50_ns) for run in runs):
        return None
    return _WindowTimes(
        (pair.a.window_p99_ns, pair.b.window_p99_ns),
        (pair.a.algo_max_ns, pair.b.algo_max_ns),
        pair.b.algo_p50_ns / pair.a.algo_p50_ns,
        min(pair.a.steps_done, pair.b.steps_done),
    )


def make_settings_table(a: Records, b: Records) -> Table | None:
    """Return a table of each folder's step time ratios of two settings of a solver, or None."""
    of_a, of_b = (
        {(one.first, one.second, one.variables): one for one in compare_settings_of_solvers(view)}
        for view in (a, b)
    )
    rows = []
    for key in dict.fromkeys((*of_a, *of_b)):
        row = {"settings": key[1], "against": key[0], "variables": f"{key[2]:.0f}"}
        for name, known in (("A", of_a), ("B", of_b)):
            value, interval = _format_ratio(known.get(key))
            row |= {f"ratio in {name}": value, f"interval in {name}": interval}
        rows.append(row)
    note = (
        "Ratio: step time with the settings divided by that with the others, on the same steps of "
        "the same run. It is a geometric mean in which replays of one size have equal weight, with "
        "a 95 % interval for each ratio alone, within its run. The machine factor between A and B "
        "cancels."
    )
    if any(UNSTABLE in cell for row in rows for cell in row.values()):
        note += " Unstable: by another measure, such as the p99, the other settings are faster."
    title = "Two settings of one solver, within each folder"
    return Table.from_rows(rows, title, note=note, text_columns=2) if rows else None


def _format_ratio(found: PairedComparison | None) -> tuple[str, str]:
    """Return a ratio and its interval as texts, dashes for none."""
    if found is None:
        return MISSING, MISSING
    ratio = found.ratio
    if found.separate:
        times = (format_microseconds(ns) for ns in (found.second_ns, found.first_ns))
        return " µs, ".join(times) + " µs", found.separate
    interval = format_interval(ratio.low, ratio.high)
    doubt = found.finding_text if found.finding_text in (MACHINE_DISTURBED, UNSTABLE) else ""
    return f"{ratio.value:.3f}", ", ".join(filter(None, (interval, doubt)))
