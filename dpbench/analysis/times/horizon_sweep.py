"""Horizon sweeps: replays of one scenario under several horizons."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.records.run_steps import StepTimes
from dpbench.analysis.statistics import UNKNOWN, Interval, estimate_percentile_interval
from dpbench.analysis.verdict.requirements import Requirements, is_right_on_every_step
from dpbench.bench.judge.rules import percentile_or_nan
from dpbench.bench.record.cell import Configuration
from dpbench.bench.record.schema import FORCES
from dpbench.scenario.tables.key_types import Horizons

HORIZON_KEYS = ("prediction_horizon", "control_horizon")


def count_qp_variables(horizons: Horizons) -> int:
    """Return the number of variables of the condensed QP: forces times control horizon."""
    return len(FORCES) * horizons[1]


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """Replay, step times and correctness of one configuration at one pair of horizons."""

    run: RunRecord
    times: StepTimes | None
    right: bool

    @property
    def median_ns(self) -> float:
        """Median step time [ns], each step's fastest repetition; NaN where steps are missing."""
        return float(np.median(self.times.algo_ns)) if self.times else math.nan

    @property
    def p99_ns(self) -> float:
        """The p99 step time [ns], each step's fastest repetition; NaN for too few steps."""
        return percentile_or_nan(self.times.algo_ns, 99) if self.times else math.nan

    @cached_property
    def p99_interval(self) -> Interval:
        """The p99 step time [ns], each step's fastest repetition, with its 95 % interval."""
        return estimate_percentile_interval(self.times.algo_ns, 99) if self.times else UNKNOWN


@dataclass(frozen=True, eq=False)
class SweptConfiguration:
    """Replays of one solver configuration over several MPC horizons."""

    configuration: Configuration
    points: dict[Horizons, SweepPoint]

    @property
    def timed_points(self) -> dict[Horizons, SweepPoint]:
        """Replays with a time for every step, the shortest horizons first."""
        shortest_first = sorted(self.points, key=_make_horizons_sort_key)
        return {h: self.points[h] for h in shortest_first if self.points[h].times is not None}

    @property
    def has_p99(self) -> bool:
        """True if any of this configuration's replays has enough steps for a p99 time."""
        return any(math.isfinite(point.p99_ns) for point in self.timed_points.values())

    def find_largest_horizons_within(self, limit_ns: float) -> Horizons | None:
        """Return the largest measured horizons with right answers and a p99 within `limit_ns`."""
        fit = [h for h, p in self.timed_points.items() if p.right and p.p99_ns <= limit_ns]
        return max(fit, key=_make_horizons_sort_key, default=None)

    def has_p99_at_longer_horizons(self, horizons: Horizons) -> bool:
        """Return whether a replay at horizons longer than given ones has a p99 time."""
        beyond = (
            p
            for h, p in self.timed_points.items()
            if _make_horizons_sort_key(h) > _make_horizons_sort_key(horizons)
        )
        return any(math.isfinite(point.p99_ns) for point in beyond)

    def has_certain_horizons_within(self, limit_ns: float) -> bool:
        """Return whether p99 intervals leave no doubt on the largest horizons within a time."""
        largest = self.find_largest_horizons_within(limit_ns)
        beyond = [
            point
            for h, point in self.timed_points.items()
            if point.right
            and (largest is None or _make_horizons_sort_key(h) >= _make_horizons_sort_key(largest))
        ]
        return not any(point.p99_interval.contains(limit_ns) for point in beyond)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Replays of one scenario with several MPC horizons, the shortest horizons first."""

    name: str
    steps: int
    sequences: dict[Horizons, str]
    swept: list[SweptConfiguration]

    @property
    def horizons(self) -> list[Horizons]:
        """All pairs of prediction and control horizon in the sweep, the shortest first."""
        return list(self.sequences)

    @property
    def has_p99(self) -> bool:
        """True if any replay of the sweep has enough steps for a p99 step time."""
        return any(swept.has_p99 for swept in self.swept)

    def find_longest_horizons_within(
        self, swept: SweptConfiguration, limit_ns: float
    ) -> Horizons | None:
        """Return a configuration's longest horizons solved rightly within a time limit, or None.

        By p99, or by the largest step where there are too few for one.
        """
        if self.has_p99:
            return swept.find_largest_horizons_within(limit_ns)
        held = [
            horizons
            for horizons, point in swept.timed_points.items()
            if point.right and point.times is not None and point.times.algo_ns.max() <= limit_ns
        ]
        return max(held, key=count_qp_variables, default=None)

    @property
    def best_configurations(self) -> list[SweptConfiguration]:
        """The best configuration of each solver and formulation; the fastest solvers first."""

        def preference(swept: SweptConfiguration) -> tuple[int, int, float, str]:
            """Return a sort key: most horizons right, most timed, then fastest."""
            right = sum(point.right for point in swept.timed_points.values())
            largest = max(swept.timed_points, key=_make_horizons_sort_key, default=None)
            slowest_ns = swept.timed_points[largest].median_ns if largest else math.inf
            return -right, -len(swept.timed_points), slowest_ns, swept.configuration.solver

        best = sorted(self.swept, key=preference)
        kinds = map_first_by_key(
            best, lambda s: (s.configuration.solver, s.configuration.formulation)
        )
        return list(kinds.values())


def find_sweeps(records: Records, requirements: Requirements) -> list[Sweep]:
    """Find the scenarios replayed with two or more pairs of MPC horizons."""
    # A sweep compares formulations, which `Records.select_runs` does not.
    replays = [run for run in records.all_runs if run.mode == "replay" and run.units == "scaled"]
    problems = group_by_key(replays, _make_key_without_horizons)
    candidates = [
        _build_sweep(records, runs, requirements) for key, runs in problems.items() if key
    ]
    return [sweep for sweep in candidates if len(sweep.sequences) > 1]


def _make_horizons_sort_key(horizons: Horizons) -> tuple[int, int]:
    """Return a sort key of an MPC horizon pair: control horizon, then prediction horizon."""
    return horizons[1], horizons[0]


def _make_key_without_horizons(run: RunRecord) -> str:
    """Return a text equal for replays of one scenario differing only in MPC horizons; or ""."""
    files = run.scenario_documents
    if files is None or run.horizons is None:
        return ""
    scenario = dict(files["scenario"])
    controller = scenario["controller"].items()
    scenario["controller"] = {k: v for k, v in controller if k not in HORIZON_KEYS}
    window = run.first_step, run.steps_planned
    return json.dumps([scenario, files["vessel"], window], sort_keys=True)


def _build_sweep(records: Records, runs: Sequence[RunRecord], requirements: Requirements) -> Sweep:
    """Group the replays of one problem at several horizons by configuration."""
    sequences: dict[Horizons, str] = {}
    points: dict[Configuration, dict[Horizons, SweepPoint]] = {}
    for run in runs:
        horizons = run.horizons
        assert horizons is not None  # or it would be of no problem that is swept
        sequences.setdefault(horizons, run.sequence)
        if run.outcome != "refused":
            times = records.get_step_times(run)
            whole = times is not None and len(times.algo_ns) == run.steps_planned
            point = SweepPoint(
                run, times if whole else None, is_right_on_every_step(run, requirements)
            )
            points.setdefault(run.configuration, {}).setdefault(horizons, point)
    return Sweep(
        name=runs[0].sequence_without_horizons,
        steps=runs[0].steps_planned,
        sequences=dict(
            sorted(sequences.items(), key=lambda item: _make_horizons_sort_key(item[0]))
        ),
        swept=[SweptConfiguration(*item) for item in points.items()],
    )
