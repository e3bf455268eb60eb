"""Closed loops on slow computers, gathered: which slowdown each solver survives."""

import math
from dataclasses import dataclass
from itertools import takewhile

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.verdict.requirements import compute_cost_ratio, has_survived
from dpbench.bench.record.cell import Configuration


@dataclass(frozen=True, eq=False)
class DelayedConfiguration:
    """Closed loops of a configuration on simulated slower computers, by slowdown."""

    configuration: Configuration
    loops: dict[float, RunRecord]

    @property
    def largest_survived_slowdown(self) -> float:
        """Largest computer slowdown up to which every closed loop survives; NaN for none."""
        survived_slowdowns = takewhile(lambda s: has_survived(self.loops[s]), self.loops)
        return max(survived_slowdowns, default=math.nan)


@dataclass(frozen=True, eq=False)
class DelayedGroup:
    """Closed loops of all configurations on slow computers in one scenario."""

    scenario: str
    steps: int
    deadline_s: float
    configurations: tuple[DelayedConfiguration, ...]


def group_delayed_loops(records: Records) -> list[DelayedGroup]:
    """Return the closed loops on simulated slow computers, grouped by scenario."""
    groups = group_by_key(records.delayed, lambda r: (r.scenario, r.steps_planned, r.deadline_s))
    delayed = []
    for key, runs in groups.items():
        rising = sorted(runs, key=lambda run: run.slowdown)
        configurations = [
            DelayedConfiguration(configuration, {run.slowdown: run for run in loops})
            for configuration, loops in group_by_key(rising, lambda run: run.configuration).items()
        ]
        delayed.append(
            DelayedGroup(*key, tuple(sorted(configurations, key=_make_survival_sort_key)))
        )
    return delayed


def _make_survival_sort_key(configuration: DelayedConfiguration) -> tuple[float, float, str]:
    """Return a sort key of configurations: largest slowdown survived, then least cost."""
    last = list(configuration.loops.values())[-1]
    values = -configuration.largest_survived_slowdown, compute_cost_ratio(last)
    survives, cost = (math.inf if math.isnan(value) else value for value in values)
    return survives, cost, last.solver_label
