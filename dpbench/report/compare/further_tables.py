"""Tables of a comparison without a verdict: windows of hardest steps, settings within a folder."""

import math
from collections.abc import Sequence

import numpy as np

from dpbench.analysis.compare.pairs import Pair
from dpbench.analysis.records.records import Records
from dpbench.analysis.times.paired_times import (
    MACHINE_DISTURBED,
    PairedComparison,
    compare_settings_of_solvers,
    match_times_by_step,
)
from dpbench.analysis.verdict.time_findings import compute_p99_ns
from dpbench.report.formats import MISSING, Table, format_interval, format_microseconds


def make_windows_table(a: Records, b: Records, pairs: Sequence[Pair]) -> Table | None:
    """Return a table of step times in windows of hardest steps of two folders; None without one."""
    rows = []
    for pair in pairs:
        if not (of := pair.a.steps_searched_for_hardest):
            continue
        times = [view.get_step_times(run) for view, run in ((a, pair.a), (b, pair.b))]
        if times[0] is None or times[1] is None:
            continue
        both = match_times_by_step(times[0], times[1])
        p99 = [compute_p99_ns(pair.a, one.algo_ns) for one in times if one is not None]
        largest = [one.max() for one in both]
        rows.append(
            {
                "configuration": pair.configuration_label,
                "window": pair.a.problem,
                "A p99 [µs]": format_microseconds(p99[0]),
                "B p99 [µs]": format_microseconds(p99[1]),
                "A largest [µs]": format_microseconds(largest[0]),
                "B largest [µs]": format_microseconds(largest[1]),
                "B/A": f"{math.exp(float(np.mean(np.log(both[1] / both[0])))):.3f}",
                "steps": f"{len(both[0])} of {of}",
            }
        )
    note = (
        "The p99 is of all steps that the hardest were chosen from; below 100 it is the largest. "
        "B/A: geometric mean over the steps of the window, the machine's factor in it. So few "
        "steps give no interval and no verdict."
    )
    title = "Step times, windows of hardest steps"
    return Table.from_rows(rows, title, note=note, text_columns=2) if rows else None


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
        "Step time of the settings over that of the others on the same steps of the same run: "
        "geometric mean, replays of one size of equal weight, with a 95 % interval for each ratio "
        "alone. The machine's factor between A and B is not in it."
    )
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
    is_disturbed = found.finding_text == MACHINE_DISTURBED
    return f"{ratio.value:.3f}", f"{interval}, {MACHINE_DISTURBED}" if is_disturbed else interval
