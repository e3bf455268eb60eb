"""Tables of the loops on slow computers: cost by slow-down, and what was missed."""

from __future__ import annotations

import math

from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.slowdown import (
    MARGIN,
    DelayedConfiguration,
    DelayedGroup,
    cost_ratio,
    survived,
)
from dpbench.report.formats import MISSING, count_text, factor_text, plural, significant, time_text
from dpbench.report.table import Cell, Table, row_of

WITHIN = f"within {100 * MARGIN:g} %"
COUNTS = (
    ("deadline_misses", "misses"),
    ("longest_miss_streak", "longest streak"),
    ("miss_recover_steps_max", "recovery [steps]"),
    ("computations", "computations"),
    ("interrupted", "interrupted"),
    ("fallbacks", "fallbacks"),
)


def survival_table(group: DelayedGroup, cpu: str) -> Table:
    """Per configuration the slow-down it survives, and its cost at each, over the exactly solved
    loop's.

    A slow-down of 1 is the computer `cpu`.
    """
    slowdowns = group.slowdowns
    return Table(
        title=f"What slow-down each solver survives in `{group.scenario}`",
        note=f"{plural(len(group.configurations), 'configuration')}, "
        f"{plural(group.steps, 'step')}, a budget of "
        f"{significant(1e3 * group.deadline_s)} ms a step; 1 × is this {cpu}. Cost over that of "
        f"the exactly solved loop, in which no answer is late; tinted where it is not {WITHIN}, "
        "or the loop was not run to its end. Survives: the largest slow-down up to which every "
        f"loop that was run stays {WITHIN} over the whole of it, without a violated limit. Step "
        "time: as measured, at the smallest slow-down. Each cell is one run; another has other "
        "latencies, so a cost near the margin settles nothing.",
        heads=(
            "solver",
            "survives",
            "step time p50",
            "step time max",
            *(f"cost at {factor_text(slowdown)}" for slowdown in slowdowns),
        ),
        rows=tuple(
            row_of(
                configuration.name,
                Cell(
                    factor_text(configuration.survives),
                    "" if math.isfinite(configuration.survives) else "bad",
                ),
                *_measured(configuration),
                *(_cost(configuration.loops.get(slowdown)) for slowdown in slowdowns),
            )
            for configuration in group.configurations
        ),
    )


def _measured(configuration: DelayedConfiguration) -> tuple[str, str]:
    """Median and largest measured step time at the smallest slow-down."""
    slowdown, row = next(iter(configuration.loops.items()))
    middle, largest = (getattr(row, f"latency_{of}_ns") / slowdown for of in ("p50", "max"))
    return time_text(middle), time_text(largest)


def _cost(row: RunRecord | None) -> Cell:
    if row is None:
        return Cell(MISSING, "quiet")
    ratio = cost_ratio(row)
    if math.isnan(ratio):
        return Cell(row.outcome.replace("_", " "), "bad")
    return Cell(significant(ratio), "" if survived(row) else "bad")


def _count(row: RunRecord, column: str) -> str:
    """A count; that of a recovery which never came is `never`."""
    never = column == "miss_recover_steps_max" and math.isnan(getattr(row, column))
    if never and row.deadline_misses > 0.0:
        return "never"
    return count_text(getattr(row, column))


def misses_table(group: DelayedGroup) -> Table:
    """Every loop with its misses, longest streak, recovery, latencies and cost."""
    rows = [
        row_of(
            configuration.name,
            factor_text(slowdown),
            *(_count(row, column) for column, _ in COUNTS),
            *(time_text(getattr(row, f"latency_{of}_ns")) for of in ("p50", "max")),
            _cost(row),
            significant(row.dev_position_max_m),
            Cell(
                count_text(row.limit_violations),
                "bad" if row.limit_violations > 0 else "",
            ),
            count_text(row.steps_done),
        )
        for configuration in group.configurations
        for slowdown, row in configuration.loops.items()
    ]
    return Table(
        title=f"Deadlines missed in `{group.scenario}`",
        note=f"{plural(len(rows), 'loop')}. A miss is a step without an answer in time: its own "
        "came late, or none was begun because the processor was still at an earlier one. "
        "Recovery: most steps from a miss to the next true answer in time, a dash where "
        "none was missed. Computations: steps in which one was begun. Fallbacks: steps in "
        "which neither an answer in time nor one that arrived just then steered. Latency: "
        "measured step time × slow-down; where the kernel interrupted a computation to run "
        "others, its processor time × slow-down, since it is not this machine that steers.",
        heads=(
            "solver",
            "slow-down",
            *(head for _, head in COUNTS),
            "latency p50",
            "latency max",
            "cost",
            "deviation max [m]",
            "violations",
            "steps",
        ),
        rows=tuple(rows),
        folded=True,
    )
