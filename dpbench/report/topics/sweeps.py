"""What a sweep shows: longer horizons, slower computers, other routes, other formulations."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.slowdown import MARGIN, cost_ratio, delayed_groups
from dpbench.analysis.times.horizon_sweep import SweptConfiguration, moves_of, sweeps
from dpbench.analysis.times.routes import native_comparisons, route_comparisons, route_policy_text
from dpbench.report.charts.lines import lines
from dpbench.report.formats import significant, time_text
from dpbench.report.page.topic import Figure, SmallTable, Topic


def horizon_topic(records: Records, demand: Demand) -> Topic | None:
    """How the step time grows with the horizon; None where it was not varied."""
    figures, tables = [], []
    for sweep in sweeps(records, demand):
        rows, points = [], []
        for swept in sweep.best:
            name = swept.configuration.label
            growth = swept.growth
            points += [
                {"name": name, "x": moves_of(h), "y": p.median_ns / 1e3, "good": p.right}
                for h, p in swept.timed.items()
            ]
            rows.append(
                (
                    name,
                    "–" if growth is None else significant(growth.exponent.value, 2),
                    _longest(swept, demand.p99_ns),
                )
            )
        if points:
            chart = lines(
                pd.DataFrame(points),
                f"Step time over the size of the QP, {sweep.name}",
                ("variables", "d"),
                ("median step time [µs]", "~g"),
                limit=demand.p99_ms * 1e3,
            )
            figures.append(
                Figure(f"horizon-{sweep.name}", chart, "Hollow: answers miss the demand there.")
            )
            head = ("configuration", "grows as n^", f"largest horizon within {demand.p99_ms:g} ms")
            tables.append(SmallTable(head, tuple(rows), sweep.name))
    if not figures:
        return None
    said = (
        "How the step time grows with the horizon, and the longest that fits the demand. ≥: no "
        "longer one has a p99; ?: the 95 % interval of a p99 holds the limit.",
    )
    return Topic("horizon", "Longer horizons", said, tuple(figures), tuple(tables))


def _longest(swept: SweptConfiguration, limit_ns: float) -> str:
    """The longest horizons within a limit, and no more than the runs say: `≥` where no longer ones
    have a p99, `?` where the interval of a p99 holds the limit."""
    if not any(math.isfinite(point.p99_ns) for point in swept.timed.values()):
        return "–"
    largest = swept.largest_within(limit_ns)
    doubt = "" if swept.settled(limit_ns) else " ?"
    if largest is None:
        return f"none{doubt}"
    least = "" if swept.measured_beyond(largest) else "≥ "
    return f"{least}{largest[0]}/{largest[1]}{doubt}"


def slowdown_topic(records: Records) -> Topic | None:
    """What a slower computer does to the ship; None where none was simulated."""
    figures, tables = [], []
    for group in delayed_groups(records):
        points = [
            {
                "name": delayed.configuration.label,
                "x": slow,
                "y": cost_ratio(run),
                "good": cost_ratio(run) <= 1.0 + MARGIN,
            }
            for delayed in group.configurations
            for slow, run in delayed.loops.items()
            if math.isfinite(cost_ratio(run)) and cost_ratio(run) > 0
        ]
        if points:
            title = f"Cost of the loop on a slower computer, {group.scenario}"
            chart = lines(
                pd.DataFrame(points),
                title,
                ("times slower than this machine", "~g"),
                ("cost over the exactly solved loop", "~g"),
                limit=1.0 + MARGIN,
            )
            figures.append(Figure(f"slowdown-{group.scenario}", chart, "Dashed: 10 % more cost."))
        head = ("configuration", "survives ×", "latest answer")
        rows = tuple(
            (
                delayed.configuration.label,
                "–" if math.isnan(delayed.survives) else f"{delayed.survives:g}",
                time_text(
                    max((r.latency_max_ns for r in delayed.loops.values()), default=math.nan)
                ),
            )
            for delayed in group.configurations
        )
        tables.append(SmallTable(head, rows, group.scenario))
    if not tables:
        return None
    said = (
        "The ship sailed with answers as late as a slower computer makes them. A configuration "
        f"survives a slow-down while the loop costs at most {100 * MARGIN:g} % more.",
    )
    return Topic("slowdown", "Slower computers", said, tuple(figures), tuple(tables))


def routes_topic(records: Records) -> Topic | None:
    """What the wrapper costs and what keeping a workspace gains; None where not compared."""
    tables = []
    for sequence in records.sequences:
        rows = []
        for comparison in native_comparisons(route_comparisons(records, sequence)):
            for route in comparison.times:
                beside = comparison.compare(route, comparison.neighbour(route))
                if beside is None:
                    continue
                low, high = beside.gain.low, beside.gain.high
                rows.append(
                    (
                        comparison.solver,
                        comparison.settings,
                        f"{route_policy_text(beside.above)} → {route_policy_text(route)}",
                        f"{significant(beside.gain.value)} ({significant(low)} to "
                        f"{significant(high)})",
                        time_text(comparison.median_ns(route)),
                    )
                )
        if rows:
            head = ("solver", "settings", "from → to", "times as fast (95 %)", "p50")
            tables.append(SmallTable(head, tuple(rows), sequence))
    if not tables:
        return None
    said = (
        "What calling a library natively saves, then keeping its workspace, then its last answer.",
    )
    return Topic("routes", "Routes", said, (), tuple(tables))


def formulations_topic(records: Records, demand: Demand) -> Topic | None:
    """The same QPs in other forms; None where no sequence was run in two."""
    replays = [
        r for r in records.all_runs if r.mode == "replay" and not r.family and not r.is_baseline_law
    ]
    problems: dict[tuple[str, str], list[RunRecord]] = {}
    for run in replays:
        problems.setdefault((run.sequence, run.units), []).append(run)
    tables = []
    for (sequence, units), runs in problems.items():
        forms = list(dict.fromkeys(run.formulation for run in runs))
        if len(forms) < 2:
            continue
        by_name: dict[str, dict[str, RunRecord]] = {}
        for run in runs:
            name = run.configuration.in_common_formulation.label
            by_name.setdefault(name, {})[run.formulation] = run
        rows = tuple(
            (name, *(_in_form(records, own.get(form), demand) for form in forms))
            for name, own in by_name.items()
        )
        title = sequence + (" (SI units)" if units == "si" else "")
        tables.append(SmallTable(("configuration", *forms), rows, title))
    if not tables:
        return None
    said = ("Median step time of the same QPs in each form; a solver is judged in the common one.",)
    return Topic("formulations", "Formulations", said, (), tuple(tables))


def _in_form(records: Records, run: RunRecord | None, demand: Demand) -> str:
    """Median step time of a replay; how it ended where it left no step."""
    times = None if run is None else records.times(run)
    if run is None or times is None:
        return "–" if run is None else run.outcome.replace("_", " ")
    text = time_text(float(np.median(times.algo_ns)))
    return text if is_right(run, demand) else f"{text} (not right)"
