"""Closed loops alone: whose answers hold the ship, and how far off it goes with those of others."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import Requirements, is_right_to_the_end
from dpbench.report.formats import MISSING, and_list, count_text, plural, significant
from dpbench.report.page.section import Topic
from dpbench.report.table import Table


def loops_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the topic on closed loops; None without one."""
    loops = records.select(mode="closed_loop")
    steered = [run for run in loops if not run.is_baseline_law and run.outcome != "refused"]
    by_name = grouped(steered, lambda run: run.configuration.in_common_formulation.label)
    if not by_name:
        return None
    whole = {
        name: sum(is_right_to_the_end(run, requirements) for run in runs)
        for name, runs in by_name.items()
    }
    most = max(len(runs) for runs in by_name.values())
    right = [name for name, runs in by_name.items() if whole[name] == len(runs) == most]
    requested = plural(most, "closed loop")
    best = max(whole, key=lambda name: whole[name])
    lead = f"Nobody is right on every step of {requested}; {best} is in {whole[best]}."
    if right:
        rest = len(by_name) - len(right)
        names = and_list(right) if len(right) <= 4 else f"{len(right)} configurations"
        others = f" {plural(rest, 'configuration')} {'is' if rest == 1 else 'are'} not."
        lead = f"Right on every step of {requested}: {names}.{others if rest else ''}"
    rows = [
        {"configuration": name, "right in": f"{whole[name]} of {len(runs)}"} | _control(runs)
        for name, runs in by_name.items()
    ]
    rows.sort(key=lambda row: -whole[row["configuration"]])
    note = "The distance from the exactly solved loop is what wrong or late answers do to the ship."
    return Topic("loops", "Closed loops", (lead, note), (), (Table.of(rows),))


def _control(runs: Sequence[RunRecord]) -> dict[str, str]:
    """Count fallbacks, and find the largest distance from the exact loop."""
    fallbacks = sum(run.fallbacks for run in runs if math.isfinite(run.fallbacks))
    off = [run for run in runs if math.isfinite(run.dev_position_max_m)]
    worst = max(off, key=lambda run: run.dev_position_max_m, default=None)
    farthest = MISSING if worst is None else f"{significant(worst.dev_position_max_m)} m"
    return {
        "steps with a fallback": count_text(fallbacks),
        "farthest from the exact loop": farthest,
        "in": MISSING if worst is None else worst.scenario,
    }
