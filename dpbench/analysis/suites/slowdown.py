"""Closed loops on slow computers, gathered: which slow-down each solver survives."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by
from dpbench.analysis.verdict.requirements import cost_ratio, has_survived
from dpbench.bench.record.configuration import Configuration


@dataclass(frozen=True, eq=False)
class DelayedConfiguration:
    """Configuration on slower and slower computers: `loops` by slow-down, rising."""

    configuration: Configuration
    loops: dict[float, RunRecord]

    @property
    def survives(self) -> float:
        """Largest slow-down up to which every loop that was run survives; NaN for none."""
        survived_slowdowns = takewhile(lambda s: has_survived(self.loops[s]), self.loops)
        return max(survived_slowdowns, default=math.nan)


@dataclass(frozen=True, eq=False)
class DelayedGroup:
    """All configurations of one scenario, with the same length and budget of a step."""

    scenario: str
    steps: int
    deadline_s: float
    configurations: tuple[DelayedConfiguration, ...]


def delayed_groups(records: Records) -> list[DelayedGroup]:
    """Group the loops on slow computers by scenario; configurations that survive most first."""
    groups = group_by(records.delayed, lambda r: (r.scenario, r.steps_planned, r.deadline_s))
    return [DelayedGroup(*key, _configurations(runs)) for key, runs in groups.items()]


def _configurations(runs: Sequence[RunRecord]) -> tuple[DelayedConfiguration, ...]:
    rising = sorted(runs, key=lambda run: run.slowdown)
    delayed = [
        DelayedConfiguration(configuration, {run.slowdown: run for run in loops})
        for configuration, loops in group_by(rising, lambda run: run.configuration).items()
    ]
    return tuple(sorted(delayed, key=_survival_key))


def _survival_key(configuration: DelayedConfiguration) -> tuple[float, float, str]:
    """Sort key: the most survived first, then the least cost of the last loop."""
    last = list(configuration.loops.values())[-1]
    values = -configuration.survives, cost_ratio(last)
    survives, cost = (math.inf if math.isnan(value) else value for value in values)
    return survives, cost, last.name
