"""Results of sweeps: longer horizons, slower computers."""

import math
from collections.abc import Sequence

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.suites.slowdown import DelayedConfiguration, group_delayed_loops
from dpbench.analysis.times.contrasts import (
    Sweep,
    SweptConfiguration,
    count_qp_variables,
    find_sweeps,
)
from dpbench.analysis.verdict.requirements import MARGIN, Requirements, compute_cost_ratio
from dpbench.report.charts.lines import draw_lines
from dpbench.report.formats import MISSING, Table, format_time, join_with_and, significant
from dpbench.report.page.section import Figure, Topic


def build_horizon_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part on step time over MPC horizon; None if it was not varied."""
    figures, tables = [], []
    all_sweeps = find_sweeps(records, requirements)
    for sweep in all_sweeps:
        rows, points = [], []
        limit = _describe_time_limit(sweep, requirements)
        for swept in sweep.best_configurations:
            name = swept.configuration.label
            points += [
                {"name": name, "x": count_qp_variables(h), "y": p.median_ns / 1e3, "good": p.right}
                for h, p in swept.timed_points.items()
            ]
            rows.append(
                {
                    "configuration": name,
                    **_format_growth(swept),
                    f"largest horizon, {limit}": _format_longest_horizons(
                        sweep, swept, requirements.p99_ns
                    ),
                }
            )
        if points:
            chart = draw_lines(
                pd.DataFrame(points),
                f"Step time over the size of the QP, {sweep.name}",
                ("variables", "d"),
                ("median step time [µs]", "~g"),
                limit=requirements.p99_ms * 1e3 if requirements.judges_step_times else None,
            )
            figures.append(
                Figure(
                    f"horizon-{sweep.name}",
                    chart,
                    "Hollow marker: at least one step is inaccurate or failed.",
                )
            )
            tables.append(Table.from_rows(rows, sweep.name))
    if not figures:
        return None
    wording = (
        *_describe_longest_horizons(all_sweeps, requirements),
        "The tables give the median step time at the fewest and the most variables, and the "
        "longest horizons at which every step is accurate and the time limit is met. ≥: longer "
        "horizons have no p99; ?: the 95 % interval of a p99 includes the limit, or has no upper "
        "end because few steps were run.",
        *_list_builds(all_sweeps),
    )
    return Topic("horizon", "Longer horizons", wording, tuple(figures), tuple(tables))


def _list_builds(sweeps: Sequence[Sweep]) -> list[str]:
    """Return a line with the builds of the solvers' libraries; none where no build is known."""
    built = (s for sweep in sweeps for s in sweep.best_configurations if s.build)
    builds = [
        f"{join_with_and(list(dict.fromkeys(s.configuration.solver for s in alike)))} ({build})"
        for build, alike in group_by_key(built, lambda s: s.build).items()
    ]
    return [f"Builds of the libraries: {', '.join(builds)}."] if builds else []


def _describe_time_limit(sweep: Sweep, requirements: Requirements) -> str:
    """Return a text on the limit on step time that a horizon has to keep."""
    limited = requirements.judges_step_times
    limit = f"within {requirements.p99_ms:g} ms" if limited else "of any size"
    return f"{_name_judging_statistic(sweep)} {limit}"


def _format_growth(swept: SweptConfiguration) -> dict[str, str]:
    """Return a configuration's range of timed QP sizes and median step times at the ends, as cells.

    No power law: at few variables the fixed cost of a call dominates, so no exponent fits them all.
    """
    ends = [*swept.timed_points.items()][:: max(1, len(swept.timed_points) - 1)]
    sizes = " to ".join(str(count_qp_variables(horizons)) for horizons, _ in ends)
    medians_ns = [point.median_ns for _, point in ends]
    times = " to ".join(map(format_time, medians_ns))
    if len(ends) == 2:
        times += f" (× {significant(medians_ns[1] / medians_ns[0], 2)})"
    return {"variables": sizes or MISSING, "median step time": times or MISSING}


def _describe_longest_horizons(
    all_sweeps: Sequence[Sweep], requirements: Requirements
) -> list[str]:
    """Return a line for each sweep on the longest horizons a solver manages within the limit."""
    wording = []
    for sweep in all_sweeps:
        largest = {
            swept.configuration.label: fits
            for swept in sweep.best_configurations
            if (fits := sweep.find_longest_horizons_within(swept, requirements.p99_ns)) is not None
        }
        limit = f"with {_describe_time_limit(sweep, requirements)}"
        if not largest:
            wording.append(f"In {sweep.name}, no solver is accurate {limit} at any horizon.")
            continue
        longest = max(largest.values(), key=count_qp_variables)
        who = [name for name, horizons in largest.items() if horizons == longest]
        some = (
            join_with_and(who) if len(who) <= 3 else f"{', '.join(who[:3])} and {len(who) - 3} more"
        )
        beyond = "" if longest != sweep.horizons[-1] else ", the longest that were run"
        wording.append(
            f"In {sweep.name}, the longest horizons (N_p/N_c) with accurate solutions and "
            f"{_describe_time_limit(sweep, requirements)} are {longest[0]}/{longest[1]}{beyond}: "
            f"{some}."
        )
    return wording


def _name_judging_statistic(sweep: Sweep) -> str:
    """Return what must be within the time limit: "p99", or each step if there are few."""
    return "p99" if sweep.has_p99 else f"each of {sweep.steps} steps"


def _format_longest_horizons(sweep: Sweep, swept: SweptConfiguration, limit_ns: float) -> str:
    """Return a solver's longest horizons within a time limit as text, with `?` if in doubt."""
    if sweep.has_p99 and not swept.has_p99:
        return MISSING
    largest = sweep.find_longest_horizons_within(swept, limit_ns)
    doubt = " ?" if sweep.has_p99 and not swept.has_certain_horizons_within(limit_ns) else ""
    if largest is None:
        return f"none{doubt}"
    least = "≥ " if sweep.has_p99 and not swept.has_p99_at_longer_horizons(largest) else ""
    return f"{least}{largest[0]}/{largest[1]}{doubt}"


def build_slowdown_topic(records: Records) -> Topic | None:
    """Return the report's part on simulated slower computers; None where none was simulated."""
    figures, tables, leads = [], [], []
    for group in group_delayed_loops(records):
        points = [
            {
                "name": delayed.configuration.label,
                "x": slow,
                "y": compute_cost_ratio(run),
                "good": compute_cost_ratio(run) <= 1.0 + MARGIN,
            }
            for delayed in group.configurations
            for slow, run in delayed.loops.items()
            if math.isfinite(compute_cost_ratio(run)) and compute_cost_ratio(run) > 0
        ]
        if points:
            title = f"Cost of the loop on a slower computer, {group.scenario}"
            chart = draw_lines(
                pd.DataFrame(points),
                title,
                ("times slower than this machine", "~g"),
                ("cost relative to the reference loop", "~g"),
                limit=1.0 + MARGIN,
            )
            figures.append(
                Figure(f"slowdown-{group.scenario}", chart, "Dashed line: 10 % more cost.")
            )
        rows = []
        for delayed in group.configurations:
            latest_ns = max(
                (run.latency_max_ns for run in delayed.loops.values()), default=math.nan
            )
            row = {"configuration": delayed.configuration.label}
            row["largest slowdown survived"] = _describe_survived(delayed)
            rows.append(row | {"largest latency": format_time(latest_ns)})
        tables.append(Table.from_rows(rows, group.scenario))
        survivors = [c for c in group.configurations if c.largest_survived_slowdown > 0]
        best = [f"{c.configuration.label} {_describe_survived(c, '× ')}" for c in survivors[:3]]
        named = ", ".join(best) if best else "none by any solver"
        leads.append(f"Largest slowdown survived in {group.scenario}: {named}.")
    if not tables:
        return None
    wording = (
        *leads,
        "Each solution is applied as late as on a slower computer. A configuration survives a "
        f"slowdown if the cost of its loop is at most {100 * MARGIN:g} % above that of the "
        "reference loop.",
    )
    return Topic("slowdown", "Slower computers", wording, tuple(figures), tuple(tables))


def _describe_survived(delayed: DelayedConfiguration, sign: str = "") -> str:
    """Return the largest slowdown survived, as a bound if none larger was run; a dash for none."""
    survived = delayed.largest_survived_slowdown
    if math.isnan(survived):
        return MISSING
    is_bound = survived == max(delayed.loops)
    at_least, note = ("at least ", " (the largest run)") if is_bound else ("", "")
    return f"{at_least}{sign}{survived:g}{note}"
