"""Contrasts of step times: routes, settings levels, formulations, and horizons.

Routes are compared with their neighbours in the order qpsolvers fresh, native fresh, native reuse,
native warm: the cost of the wrapper, the gain of a kept workspace, that of a warm start.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.records.run_steps import StepTimes
from dpbench.analysis.statistics import (
    UNKNOWN,
    Interval,
    estimate_paired_time_ratio,
    estimate_percentile_interval,
)
from dpbench.analysis.times.paired_times import TimedReplay, match_times_by_step
from dpbench.analysis.verdict.requirements import Requirements, is_right_on_every_step
from dpbench.bench.judge.rules import median_of_known, percentile_or_nan
from dpbench.bench.record.cell import Configuration, sort_key_of_settings
from dpbench.bench.record.schema import FORCES
from dpbench.scenario.tables.key_types import Horizons

RoutePolicy = tuple[str, str]

WRAPPED, NATIVE, KEPT, WARM = (
    ("qpsolvers", "fresh"),
    ("native", "fresh"),
    ("native", "reuse"),
    ("native", "warm"),
)
WRAPPED_WARM = ("qpsolvers", "warm")
ABOVE: dict[RoutePolicy, tuple[RoutePolicy, ...]] = {
    NATIVE: (WRAPPED,),
    KEPT: (NATIVE,),
    WARM: (KEPT, NATIVE),
    WRAPPED_WARM: (WRAPPED,),
}
"""Neighbours a route is compared with: the first that was measured."""


@dataclass(frozen=True)
class RouteGain:
    """Speed-up of one call mode of a solver (interface, warm start) over the next simpler one.

    gain : geometric mean of the neighbour's time over this one's, over their common steps; unknown
        where they were not interleaved, for the reason `separate`.
    median_ns, above_ns : median of its algorithmic step time, and of the neighbour's.
    """

    solver: str
    settings: str
    above: RoutePolicy
    route: RoutePolicy
    gain: Interval
    median_ns: float
    above_ns: float
    separate: str


def compare_routes(records: Records, sequence: str) -> list[RouteGain]:
    """Return each solver's speed-ups by call mode over the next simpler one, fastest solver first.

    None where no native route has a neighbour.
    """
    medians: dict[tuple[float, str], list[RouteGain]] = {}
    by_solver = group_by_key(
        records.select_replays(sequence), lambda run: (run.solver, run.settings)
    )
    for (solver, settings), runs in by_solver.items():
        timed = ((run, records.get_step_times(run)) for run in runs)
        modes: dict[RoutePolicy, TimedReplay] = {
            (run.route, run.policy): (run, own) for run, own in timed if own is not None
        }
        if any(route == "native" for route, _ in modes):
            fastest = min(float(np.median(own.algo_ns)) for _, own in modes.values())
            gains_of = medians.setdefault((fastest, solver), [])
            for route, replay in modes.items():
                above = next((above for above in ABOVE.get(route, ()) if above in modes), None)
                found = None if above is None else _compare_call_modes(modes[above], replay)
                if above is not None and found is not None:
                    gains_of.append(RouteGain(solver, settings, above, route, *found))
    gains = [gain for key in sorted(medians) for gain in medians[key]]
    return gains if any(gain.route[0] == "native" for gain in gains) else []


def _compare_call_modes(
    above: TimedReplay, own: TimedReplay
) -> tuple[Interval, float, float, str] | None:
    """Return gain, medians [ns] and why there is no gain or ""; None without common steps."""
    (above_run, above_times), (run, times) = above, own
    both = match_times_by_step(above_times, times)
    if not len(both[0]):
        return None
    separate = run.explain_separate_timing(above_run)
    medians = float(np.median(times.algo_ns)), float(np.median(above_times.algo_ns))
    gain = UNKNOWN if separate else estimate_paired_time_ratio(*both)
    return gain, *medians, separate


def find_right_levels_by_solver(
    records: Records, requirements: Requirements
) -> dict[str, list[str]]:
    """Return, by solver, the tolerance settings at which it is right on every step."""
    runs = sorted(records.runs, key=lambda run: sort_key_of_settings(run.settings))
    levels: dict[str, list[str]] = {run.solver: [] for run in runs}
    for (solver, level), own in group_by_key(runs, lambda run: (run.solver, run.settings)).items():
        if all(is_right_on_every_step(run, requirements) for run in own):
            levels[solver].append(level)
    return levels


def count_wins_of_formulations(records: Records, requirements: Requirements) -> Counter[str]:
    """Return how often each QP formulation has the least median step time.

    Of the configurations that are right on a sequence in two at least, interleaved.
    """
    by_case: dict[tuple[str, ...], dict[str, float]] = {}
    for run in records.all_runs:
        times = (
            records.get_step_times(run)
            if run.mode == "replay" and not run.is_outside_verdicts
            else None
        )
        if times is not None and is_right_on_every_step(run, requirements):
            label = run.configuration.moved_to_common_formulation.label
            case = run.sequence, run.units, label, run.turns
            by_case.setdefault(case, {})[run.formulation] = median_of_known(times.algo_ns)
    cases = [forms for forms in by_case.values() if len(forms) > 1]
    return Counter(min(forms, key=lambda form: forms[form]) for forms in cases)


def yield_matched_replays(
    records: Records, first: str, second: str
) -> Iterator[tuple[TimedReplay, TimedReplay]]:
    """Yield timed replays of two solvers in equal call modes, with their step times."""
    for sequence in records.sequences:
        for run in records.select_replays(sequence, solver=first):
            rivals = (
                other
                for other in records.select_replays(sequence, solver=second)
                if other.configuration.make_label_with_name(first) == run.configuration.label
            )
            rival = next(rivals, None)
            here, there = (
                records.get_step_times(run),
                None if rival is None else records.get_step_times(rival),
            )
            if rival is not None and here is not None and there is not None:
                yield (run, here), (rival, there)


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
    def build(self) -> str:
        """Build of the solver's library at the shortest horizons; "" if it is unknown."""
        return next(iter(self.points.values())).run.build

    @property
    def has_p99(self) -> bool:
        """True if any of this configuration's replays has enough steps for a p99 time."""
        return any(math.isfinite(point.p99_ns) for point in self.timed_points.values())

    def find_largest_horizons_within(self, limit_ns: float) -> Horizons | None:
        """Return the largest horizons, right and with p99 within `limit_ns`; None for none."""
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
        """The best one of each solver, formulation and own settings; the fastest solvers first."""

        def preference(swept: SweptConfiguration) -> tuple[int, int, float, str]:
            """Return a sort key: most horizons right, most timed, then fastest."""
            right = sum(point.right for point in swept.timed_points.values())
            largest = max(swept.timed_points, key=_make_horizons_sort_key, default=None)
            slowest_ns = swept.timed_points[largest].median_ns if largest else math.inf
            return -right, -len(swept.timed_points), slowest_ns, swept.configuration.solver

        best = sorted(self.swept, key=preference)

        def kind(swept: SweptConfiguration) -> tuple[str, str, str]:
            """Return what may be listed more than once for each solver."""
            of = swept.configuration
            return of.solver, of.formulation, of.options

        return list(map_first_by_key(best, kind).values())


def find_sweeps(records: Records, requirements: Requirements) -> list[Sweep]:
    """Return the scenarios replayed with two or more pairs of MPC horizons."""
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
    """Return the replays of one problem at several horizons, grouped by configuration."""
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
