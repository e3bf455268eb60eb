"""Closed loops on slow computers, gathered: which slow-down each solver survives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dpbench.analysis.records import COMMON, Records, RunRecord, as_float, configuration_name

MARGIN = 0.1
"""A loop survives a slow-down with a cost within this share of the exactly solved loop's."""


@dataclass(frozen=True, eq=False)
class DelayedConfiguration:
    """One solver, run in one way, on slower and slower computers; `loops` by slow-down, rising."""

    name: str
    solver: str
    loops: dict[float, RunRecord]

    @property
    def survives(self) -> float:
        """Largest slow-down up to which every loop that was run survives; NaN for none."""
        found = math.nan
        for slowdown, row in self.loops.items():
            if not survived(row):
                break
            found = slowdown
        return found


@dataclass(frozen=True, eq=False)
class DelayedGroup:
    """All configurations of one scenario, with the same length and budget of a step."""

    scenario: str
    steps: int
    deadline_s: float
    configurations: tuple[DelayedConfiguration, ...]

    @property
    def slowdowns(self) -> list[float]:
        """The slow-downs that were run, rising."""
        return sorted(
            {slowdown for configuration in self.configurations for slowdown in configuration.loops}
        )


def delayed_groups(records: Records) -> list[DelayedGroup]:
    """The loops on slow computers by scenario, configurations that survive most first."""
    groups: dict[tuple[str, int, float], list[RunRecord]] = {}
    for row in records.delayed:
        key = str(row["scenario"]), int(row["steps_planned"]), as_float(row["deadline_s"])
        groups.setdefault(key, []).append(row)
    return [
        DelayedGroup(*key, configurations=_configurations(rows)) for key, rows in groups.items()
    ]


def _configurations(rows: Sequence[RunRecord]) -> tuple[DelayedConfiguration, ...]:
    configurations: dict[tuple[str, str], dict[float, RunRecord]] = {}
    for row in sorted(rows, key=lambda row: as_float(row["slowdown"])):
        key = _name(row), str(row["solver"])
        configurations.setdefault(key, {})[as_float(row["slowdown"])] = row
    found = [
        DelayedConfiguration(name, solver, loops)
        for (name, solver), loops in configurations.items()
    ]
    return tuple(sorted(found, key=_by_survival))


def _name(row: RunRecord) -> str:
    """The configuration, with units and formulation where they are not the usual ones."""
    words = [configuration_name(row)]
    words += [str(row["units"])] if row["units"] != "scaled" else []
    unusual = row["formulation"] not in (COMMON, "none")
    words += [str(row["formulation"]).replace("_", " ")] if unusual else []
    return ", ".join(words)


def _by_survival(configuration: DelayedConfiguration) -> tuple[float, float, str]:
    """Those that survive most first, then those whose last loop costs least."""
    last = [as_float(cost_ratio(row)) for row in configuration.loops.values()][-1]
    survives = configuration.survives
    return (
        math.inf if math.isnan(survives) else -survives,
        math.inf if math.isnan(last) else last,
        configuration.name,
    )


def cost_ratio(row: RunRecord) -> float:
    """Cost over that of the exactly solved loop; NaN for a loop that was not run to its end."""
    if not as_float(row["steps_done"]) >= as_float(row["steps_planned"]):
        return math.nan
    return as_float(row["closed_loop_cost"]) / as_float(row["exact_cost"])


def survived(row: RunRecord) -> bool:
    """Whether a loop was run to its end, at a cost within `MARGIN` and without a violation."""
    return cost_ratio(row) <= 1.0 + MARGIN and as_float(row["limit_violations"]) == 0.0
