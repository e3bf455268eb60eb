"""Results of solvers that were stopped after a number of iterations or a time."""

import math
from collections.abc import Sequence

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.suites.anytime import (
    LimitedGroup,
    LimitOf,
    RequiredLimit,
    find_required_limits,
    group_limited_runs,
)
from dpbench.analysis.verdict.requirements import MARGIN, Requirements, compute_cost_ratio
from dpbench.analysis.verdict.verdict import find_solver_record_or_none
from dpbench.report.charts.lines import draw_lines
from dpbench.report.charts.style import ERROR, FLOOR
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_error,
    format_time,
    join_with_and,
    plural,
    significant,
)
from dpbench.report.page.section import Figure, Topic


def build_anytime_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part on limited solves; None unless a configuration ran two limits."""
    groups = group_limited_runs(records)
    if not groups:
        return None
    loops = [group for group in groups if group.mode == "closed_loop"]
    by_kind = group_by_key(loops, lambda group: group.limit_of).values()
    wording = (
        *(map(_describe_loops, by_kind) if loops else map(_describe_errors, groups)),
        *(_LIMITS[kind] for kind in dict.fromkeys(group.limit_of for group in groups)),
        *_describe_outer_limits(groups),
    )
    figures = (_draw_group(group, requirements) for group in groups)
    return Topic(
        "anytime",
        "Solves stopped early",
        wording,
        tuple(figure for figure in figures if figure is not None),
        tuple(map(_make_table, loops)),
    )


def _describe_loops(loops: Sequence[LimitedGroup]) -> str:
    """Return sentences on the least limit that suffices in all closed loops, and the ship there."""
    required = find_required_limits(loops)
    count = len(loops)
    where = f"In all {count} scenarios" if count > 1 else f"In `{loops[0].problem}`"
    first = required[0].limit
    if math.isinf(first):
        return f"{where} no configuration stays within {_SHARE} at any of the limits."
    best = [one for one in required if one.limit == first]
    names = [one.configuration.marked_label for one in best]
    named = join_with_and(names) if len(names) <= 4 else plural(len(names), "configuration")
    never = sum(math.isinf(one.limit) for one in required)
    others = f"; {never} of {len(required)} configurations exceed it at all limits" if never else ""
    limit = f"a limit of {_format_limit(loops[0], first)} per step"
    return f"{where} {limit} keeps {named} within {_SHARE}{others}. {_describe_ship_at_limit(best)}"


def _describe_ship_at_limit(best: Sequence[RequiredLimit]) -> str:
    """Return a sentence on unfinished steps and the ship's largest deviation at a limit."""
    runs = [run for one in best for run in one.runs]
    unfinished, steps = (sum(run.unconverged for run in runs), sum(run.steps_done for run in runs))
    known = [run for run in runs if math.isfinite(run.dev_position_max_m)]
    farthest = max(known, key=lambda run: run.dev_position_max_m, default=None)
    text = f"At this limit {format_count(unfinished)} of {plural(steps, 'step')} are unfinished"
    if farthest is None:
        return f"{text}."
    return (
        f"{text}, and the ship is up to {significant(farthest.dev_position_max_m)} m from the "
        f"reference loop, in `{farthest.problem}`."
    )


def _describe_errors(group: LimitedGroup) -> str:
    """Return a sentence on the errors of a replay at its largest limit."""
    last = group.limits[-1]
    errors = [c.runs[last].error_move_max for c in group.configurations if last in c.runs]
    least, most = format_error(min(errors)), format_error(max(errors))
    return (
        f"In the replay of {group.problem}, the largest error of the first move at a limit of "
        f"{_format_limit(group, last)} per step is {least} to {most} times the maximum increment, "
        "depending on the configuration."
    )


_LIMITS: dict[LimitOf, str] = {
    "iterations": "Every solve is stopped after a number of iterations, and the loop applies the "
    "unfinished iterate. Iterations of different methods do not cost the same.",
    "time": "Every solve is stopped after a time by the solver's own clock, and the loop applies "
    "the unfinished iterate. Most read the clock between iterations, so a step takes longer. The "
    "clock counts waits for the processor core too.",
}


def _format_limit(group: LimitedGroup, limit: float) -> str:
    """Return a limit of a group as text, with its unit."""
    return format_time(1e9 * limit) if group.limit_of == "time" else plural(limit, "iteration")


_SHARE = f"{100 * MARGIN:g} % of the cost of the reference loop"


def _describe_outer_limits(groups: list[LimitedGroup]) -> list[str]:
    """Return a sentence on solvers whose limit counts outer iterations; none without them."""
    solvers = dict.fromkeys(c.configuration.solver for g in groups for c in g.configurations)
    outer = [s for s in solvers if getattr(find_solver_record_or_none(s), _OUTER, False)]
    return [f"The limit of {join_with_and(outer)} counts outer iterations."] if outer else []


_OUTER = "limits_outer_iterations"


def _draw_group(group: LimitedGroup, requirements: Requirements) -> Figure | None:
    """Return the figure of a closed loop's cost, or of a replay's error, over the limit."""
    steered = group.mode == "closed_loop"
    limit = 1.0 + MARGIN if steered else requirements.error_move
    points = [
        {"name": one.configuration.label, "x": at, "y": y, "good": y <= limit}
        for one in group.configurations
        for at, run in one.runs.items()
        if math.isfinite(y := compute_cost_ratio(run) if steered else run.error_move_max)
    ]
    if not points:
        return None
    table = pd.DataFrame(points)
    table["y"] = table["y"].clip(lower=FLOOR)
    name, quantity, caption = (
        ("Cost of the loop", "cost relative to the reference loop", "Dashed line: 10 % more cost.")
        if steered
        else ("Error", ERROR, "Dashed line: largest error allowed.")
    )
    timed = group.limit_of == "time"
    title = f"{name} over the limit of {group.limit_of}, {group.problem}"
    axes = ("limit of time [s]", "~g") if timed else ("limit of iterations", "d")
    chart = draw_lines(table, title, axes, (quantity, "~g"), limit=limit)
    kind = "anytime-time" if timed else "anytime"
    return Figure(f"{kind}-{group.mode}-{group.problem}", chart, caption)


_UNKNOWN = math.nan, math.nan


def _make_table(group: LimitedGroup) -> Table:
    """Return the table of a closed loop: the least limit that suffices, and the ship below it."""
    rows, smallest, timed = [], group.limits[0], group.limit_of == "time"
    at = _format_limit(group, smallest)
    for one in sorted(group.configurations, key=lambda one: one.least_sufficient_limit):
        enough = one.least_sufficient_limit
        kept = one.runs.get(enough) if math.isfinite(enough) else None
        run = one.runs.get(smallest)
        cost, off_m = (compute_cost_ratio(run), run.dev_position_max_m) if run else _UNKNOWN
        rows.append(
            {
                "configuration": one.configuration.label,
                f"least {'time' if timed else 'iterations'} for at most 10 % more cost": (
                    _format_least_limit(group, enough)
                ),
                "unfinished steps there": _format_unfinished(kept),
                "largest error there": _format_error(kept),
                f"cost ratio at {at}": _format_number(cost),
                f"largest deviation at {at} [m]": _format_number(off_m),
            }
            | (
                {f"median timing at {at}": format_time(run.raw_p50_ns if run else math.nan)}
                if timed
                else {}
            )
        )
    note = (
        "A step is unfinished if its solve ended at the limit; its iterate was applied. Deviation: "
        "distance from the ship of the reference loop."
    )
    name = f"{group.problem}, limits of time" if timed else group.problem
    return Table.from_rows(rows, name, note=note)


def _format_least_limit(group: LimitedGroup, limit: float) -> str:
    """Return the least limit of a group that suffices as text; "none" for an infinite one."""
    if math.isinf(limit):
        return "none"
    return _format_limit(group, limit) if group.limit_of == "time" else f"{limit:g}"


def _format_unfinished(run: RunRecord | None) -> str:
    """Return the number of a run's steps with an unfinished iterate as text."""
    if run is None:
        return MISSING
    return f"{format_count(run.unconverged)} of {format_count(run.steps_done)}"


def _format_error(run: RunRecord | None) -> str:
    """Return the largest error of the first move of a run as text; a dash without a run."""
    return MISSING if run is None else format_error(run.error_move_max)


def _format_number(value: float) -> str:
    """Return a number in three digits; a dash for one that is not finite."""
    return significant(value) if math.isfinite(value) else MISSING
