"""Where thrusters are steered: what the answers of each solver cost in power and wear.

Against the best there is in the same scenario: of the loops that are right on every step and ran as
far, the one nearest to the exactly solved loop. What differs from it is the solver's doing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.demand import Demand, is_right_to_the_end
from dpbench.analysis.verdict.steering import is_about_thrusters
from dpbench.report.formats import MISSING, and_list, plural, significant
from dpbench.report.page.topic import SmallTable, Topic

HEAD = ("configuration", "right in", "power", "wear", "azimuth travel", "farthest off")
MOST_ROWS = 8
"""Rows on the page, the rightest first; all of them are a file."""
LIKE = 0.01
"""Shares of power and wear that differ by less are alike."""


def thrusters_topic(records: Records, demand: Demand) -> Topic | None:
    """The topic; None where no thruster is steered."""
    runs = [
        run
        for run in records.select(mode="closed_loop")
        if math.isfinite(run.power_share) and not run.is_baseline_law and not run.slowdown > 0.0
    ]
    right = [run for run in runs if is_right_to_the_end(run, demand)]
    if not right:
        return None
    best = {name: _nearest(right, name) for name in sorted({run.scenario for run in right})}
    configurations: dict[str, list[RunRecord]] = {}
    for run in runs:
        if run.scenario in best:
            name = run.configuration.in_common_formulation.label
            configurations.setdefault(name, []).append(run)
    lead = _lead(best, configurations, demand)
    if not is_about_thrusters(records):
        # Where thrusters are one scenario among others, what they cost is not what is asked.
        return Topic("thrusters", "Thrusters", (lead,))
    rows = sorted(
        (_row(name, of_it, best, demand) for name, of_it in configurations.items()),
        key=lambda row: (-int(row[1].split(" ")[0]), row[0]),
    )
    kept = list({row[0].split(" (")[0]: row for row in reversed(rows)}.values())[::-1]
    note = (
        "Power is Σ|f|^1.5 over all thrusters and wear Σ|Δf|/T, as a ratio to the right loop that "
        "is nearest to the exactly solved one; the largest of the scenarios that ran to their end. "
        "One configuration a solver, the one that is right most often."
    )
    if len(kept) > MOST_ROWS:
        note += " All of them: tables/thrusters.csv."
    table = SmallTable(HEAD, tuple(kept), shown=MOST_ROWS)
    return Topic("thrusters", "Thrusters", (lead, note), (), (table,))


def _nearest(right: Sequence[RunRecord], scenario: str) -> RunRecord:
    of_it = [run for run in right if run.scenario == scenario]
    return min(of_it, key=lambda run: (-run.steps_done, run.dev_position_max_m))


def _lead(
    best: dict[str, RunRecord], configurations: dict[str, list[RunRecord]], demand: Demand
) -> str:
    """How hard the thrusters work, and how many configurations keep up."""
    hardest = max(best.values(), key=lambda run: run.at_limit_thrusters)
    whole = sum(
        {run.scenario for run in runs if is_right_to_the_end(run, demand)} == set(best)
        for runs in configurations.values()
    )
    return (
        f"In {hardest.scenario} a thruster is at its limit in "
        f"{100.0 * hardest.at_limit_thrusters:.0f} % of the "
        f"{plural(hardest.steps_done, 'step')} run; {whole} of "
        f"{plural(len(configurations), 'configuration')} {'is' if whole == 1 else 'are'} right on "
        f"every step of {and_list(sorted(best))}."
    )


def _row(
    name: str, runs: Sequence[RunRecord], best: dict[str, RunRecord], demand: Demand
) -> tuple[str, ...]:
    ended = [run for run in runs if run.steps_done == best[run.scenario].steps_done]
    right = sum(is_right_to_the_end(run, demand) for run in runs)
    columns = ("power_share", "thrust_variation", "azimuth_travel_deg")
    ratios = [_ratio(ended, best, column) for column in columns]
    off = [run.dev_position_max_m for run in ended if math.isfinite(run.dev_position_max_m)]
    farthest = f"{significant(max(off))} m" if off else MISSING
    return (name, f"{right} of {len(best)}", *ratios, farthest)


def _ratio(runs: Sequence[RunRecord], best: dict[str, RunRecord], column: str) -> str:
    """The largest ratio of a metric to that of the best loop, over the scenarios."""
    ratios = [
        getattr(run, column) / getattr(best[run.scenario], column)
        for run in runs
        if getattr(best[run.scenario], column) > 0.0
    ]
    if not ratios:
        return MISSING
    largest = max(ratios)
    return "alike" if abs(largest - 1.0) < LIKE else f"× {significant(largest)}"
