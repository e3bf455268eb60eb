"""Power and wear of commanded thrusters, by solver.

Against the best loop in the same scenario: of those that are right on every step and ran as far,
the one nearest to the exactly solved loop. What differs from it is due to the solver.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import Requirements, is_right_to_the_end
from dpbench.analysis.verdict.steering import (
    is_about_thrusters,
    largest_ratio,
    thruster_control_loops,
)
from dpbench.report.formats import MISSING, and_list, plural, significant
from dpbench.report.page.section import Topic
from dpbench.report.table import Table

MOST_ROWS = 8
"""Rows on the page, the rightest first; all of them are a file."""
LIKE = 0.01
"""Shares of power and wear that differ by less are alike."""


def thrusters_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the topic on power and wear; None without commanded thrusters."""
    found = thruster_control_loops(records, requirements)
    if not found.best:
        return None
    best, configurations = found.best, found.configurations
    lead = _lead(best, configurations, requirements)
    if not is_about_thrusters(records):
        # Where thrusters are one scenario among others, what they cost is not what is asked.
        return Topic("thrusters", "Thrusters", (lead,))
    rows = [row_of(name, of_it, best, requirements) for name, of_it in configurations.items()]
    rows.sort(key=lambda row: (-int(row["right in"].split(" ")[0]), row["configuration"]))
    by_solver = {row["configuration"].split(" (")[0]: row for row in reversed(rows)}
    kept = list(by_solver.values())[::-1]
    note = (
        "Power is Σ|f|^1.5 over all thrusters and wear Σ|Δf|/T, as a ratio to the right loop that "
        "is nearest to the exactly solved one; the largest of the scenarios that ran to their end. "
        "One configuration a solver, the one that is right most often."
    )
    if len(kept) > MOST_ROWS:
        note += " All of them: tables/thrusters.csv."
    table = Table.of(kept, shown=MOST_ROWS)
    return Topic("thrusters", "Thrusters", (lead, note), (), (table,))


def _lead(
    best: dict[str, RunRecord],
    configurations: dict[str, list[RunRecord]],
    requirements: Requirements,
) -> str:
    hardest = max(best.values(), key=lambda run: run.at_limit_thrusters)
    whole = sum(
        {run.scenario for run in runs if is_right_to_the_end(run, requirements)} == set(best)
        for runs in configurations.values()
    )
    return (
        f"In {hardest.scenario} a thruster is at its limit in "
        f"{100.0 * hardest.at_limit_thrusters:.0f} % of the "
        f"{plural(hardest.steps_done, 'step')} run; {whole} of "
        f"{plural(len(configurations), 'configuration')} {'is' if whole == 1 else 'are'} right on "
        f"every step of {and_list(sorted(best))}."
    )


def row_of(
    name: str, runs: Sequence[RunRecord], best: dict[str, RunRecord], requirements: Requirements
) -> dict[str, str]:
    """Return the cells of a configuration by their heads."""
    ended = [run for run in runs if run.steps_done == best[run.scenario].steps_done]
    right = sum(is_right_to_the_end(run, requirements) for run in runs)
    off = [run.dev_position_max_m for run in ended if math.isfinite(run.dev_position_max_m)]
    return {
        "configuration": name,
        "right in": f"{right} of {len(best)}",
        "power": _ratio(ended, best, "power_share"),
        "wear": _ratio(ended, best, "thrust_variation"),
        "azimuth travel": _ratio(ended, best, "azimuth_travel_deg"),
        "farthest off": f"{significant(max(off))} m" if off else MISSING,
    }


def _ratio(runs: Sequence[RunRecord], best: dict[str, RunRecord], column: str) -> str:
    """Return the largest ratio of a metric to that of the best loop, over the scenarios."""
    largest = largest_ratio(runs, best, column)
    if math.isnan(largest):
        return MISSING
    return "alike" if abs(largest - 1.0) < LIKE else f"× {significant(largest)}"
