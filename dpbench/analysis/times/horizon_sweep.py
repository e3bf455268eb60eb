"""Horizon sweeps: which replays are of one scenario under several horizons, and their
configurations."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records, RunRecord, as_float
from dpbench.analysis.statistics import UNKNOWN, Interval, percentile, percentile_interval
from dpbench.analysis.step_times import StepTimes
from dpbench.analysis.times.growth import Growth, fit_growth
from dpbench.bench.record.schema import FORCES

Horizons = tuple[int, int]
"""N_p and N_c."""
HORIZON_KEYS = ("prediction_horizon", "control_horizon")


def moves_of(horizons: Horizons) -> int:
    """How many moves a plan has: the n of the condensed form, on which all forms are compared."""
    return len(FORCES) * horizons[1]


@dataclass(frozen=True, eq=False)
class Point:
    """One configuration at one pair of horizons; `times` None where it did not do every step."""

    row: RunRecord
    times: StepTimes | None
    right: bool

    @property
    def median_ns(self) -> float:
        """Median of the algorithmic step time; NaN where steps are missing."""
        return float(np.median(self.times.algo_ns)) if self.times else math.nan

    @property
    def p99_ns(self) -> float:
        """Its p99; NaN where the steps do not support one."""
        return percentile(self.times.algo_ns, 99) if self.times else math.nan

    @cached_property
    def p99_interval(self) -> Interval:
        """It with its bootstrap interval over steps."""
        return percentile_interval(self.times.algo_ns, 99) if self.times else UNKNOWN


@dataclass(frozen=True, eq=False)
class SweptConfiguration:
    """One way of running a solver on one formulation, over the horizons of a sweep."""

    solver: str
    formulation: str
    route: str
    policy: str
    settings: str
    points: dict[Horizons, Point]

    @property
    def rows(self) -> list[RunRecord]:
        """The rows of its points."""
        return [point.row for point in self.points.values()]

    @property
    def timed(self) -> dict[Horizons, Point]:
        """The points with a time for every step."""
        return {h: point for h, point in self.points.items() if point.times is not None}

    @property
    def right(self) -> bool:
        """Whether all answers behind its times meet the demand."""
        return all(point.right for point in self.timed.values())

    @property
    def way(self) -> str:
        """Route and policy, and the settings where they are not `default`."""
        extra = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.route} {self.policy}{extra}"

    @cached_property
    def growth(self) -> Growth | None:
        """The power law of its medians over the number of moves; None below three points."""
        found = [(moves_of(h), p.times.algo_ns) for h, p in self.timed.items() if p.times]
        return fit_growth([n for n, _ in found], [times for _, times in found])

    def largest_within(self, limit_ns: float) -> Horizons | None:
        """The largest horizons measured with right answers and a p99 of at most `limit_ns`."""
        fit = [h for h, p in self.timed.items() if p.right and p.p99_ns <= limit_ns]
        return max(fit, key=_by_moves, default=None)

    def measured_beyond(self, horizons: Horizons) -> bool:
        """Whether longer horizons have a p99, be their answers right or not."""
        beyond = (p for h, p in self.timed.items() if _by_moves(h) > _by_moves(horizons))
        return any(math.isfinite(point.p99_ns) for point in beyond)

    def settled(self, limit_ns: float) -> bool:
        """Whether no interval of a p99 of right answers from there on holds `limit_ns`."""
        largest = self.largest_within(limit_ns)
        beyond = [
            point
            for h, point in self.timed.items()
            if point.right and (largest is None or _by_moves(h) >= _by_moves(largest))
        ]
        return not any(point.p99_interval.spans(limit_ns) for point in beyond)


@dataclass(frozen=True, eq=False)
class Sweep:
    """The replays of one scenario under several horizons, the shortest first."""

    name: str
    steps: int
    sequences: dict[Horizons, str]
    configurations: list[SweptConfiguration]

    @property
    def horizons(self) -> list[Horizons]:
        """All pairs, by the number of moves."""
        return list(self.sequences)

    @property
    def formulations(self) -> list[str]:
        """The formulations that left a time."""
        return list(
            dict.fromkeys(
                configuration.formulation
                for configuration in self.configurations
                if configuration.timed
            )
        )

    @property
    def best_configurations(self) -> list[SweptConfiguration]:
        """Of each solver and formulation the best way; the fastest solvers first."""
        best: dict[tuple[str, str], SweptConfiguration] = {}
        for configuration in sorted(self.configurations, key=_preference):
            best.setdefault((configuration.solver, configuration.formulation), configuration)
        return sorted(best.values(), key=_preference)


def sweeps(records: Records, demand: Demand) -> list[Sweep]:
    """The sweeps in the records: scenarios that were replayed under two horizons at least."""
    groups: dict[str, list[RunRecord]] = {}
    # A sweep compares formulations, which `Records.select` does not.
    replayed = (r for r in records.all_runs if r["mode"] == "replay" and r["units"] == "scaled")
    for row in replayed:
        key = _problem_key(row)
        if key:
            groups.setdefault(key, []).append(row)
    found = [_sweep(records, rows, demand) for rows in groups.values()]
    return [sweep for sweep in found if len(sweep.sequences) > 1]


def between_ends(found: Sequence[Sweep]) -> set[str]:
    """The sequences between the shortest and the longest horizons of a sweep.

    What other sections say of each sequence repeats itself over a sweep, so they keep to its ends.
    """
    return {name for sweep in found for name in list(sweep.sequences.values())[1:-1]}


def _by_moves(horizons: Horizons) -> tuple[int, int]:
    return horizons[1], horizons[0]


def _horizons_of(row: RunRecord) -> Horizons:
    return int(row["N_p"]), int(row["N_c"])


def _problem_key(row: RunRecord) -> str:
    """Equal for replays that differ in their horizons only; empty where there is no scenario."""
    cell = json.loads(row["cell"]) if row["cell"] else {}
    documents = cell.get("scenario", {})
    if "scenario" not in documents or math.isnan(as_float(row["N_c"])):
        return ""
    scenario = dict(documents["scenario"])
    controller = scenario["controller"].items()
    scenario["controller"] = {k: v for k, v in controller if k not in HORIZON_KEYS}
    window = cell.get("first", 0), int(row["steps_planned"])
    return json.dumps([scenario, documents["vessel"], window], sort_keys=True)


def _sweep(records: Records, rows: Sequence[RunRecord], demand: Demand) -> Sweep:
    pairs = sorted({_horizons_of(row) for row in rows}, key=_by_moves)
    sequences = {
        pair: next(str(r["sequence"]) for r in rows if _horizons_of(r) == pair) for pair in pairs
    }
    configurations: dict[tuple[str, str, str, str, str], dict[Horizons, Point]] = {}
    for row in rows:
        if row["outcome"] == "refused":
            continue
        way = str(row["route"]), str(row["policy"]), str(row["settings"])
        points = configurations.setdefault((str(row["solver"]), str(row["formulation"]), *way), {})
        points.setdefault(_horizons_of(row), _point(records, row, demand))
    return Sweep(
        name=_name(rows[0]),
        steps=int(rows[0]["steps_planned"]),
        sequences=sequences,
        configurations=[
            SweptConfiguration(*key, points=points) for key, points in configurations.items()
        ],
    )


def _name(row: RunRecord) -> str:
    """The sequence without its horizons: `paper-60-10[0:300]` is of the sweep `paper[0:300]`."""
    name, bracket, window = str(row["sequence"]).partition("[")
    N_p, N_c = _horizons_of(row)
    return name.removesuffix(f"-{N_p}-{N_c}") + bracket + window


def _point(records: Records, row: RunRecord, demand: Demand) -> Point:
    """A cell that was stopped before it had done every step once has no time to compare."""
    times = records.times(row)
    whole = times is not None and len(times.algo_ns) == int(row["steps_planned"])
    return Point(row, times if whole else None, is_right(row, demand))


def _preference(configuration: SweptConfiguration) -> tuple[int, int, float, str]:
    """Sort key: most horizons with right answers, most with a time, then the fastest."""
    right = sum(point.right for point in configuration.timed.values())
    largest = max(configuration.timed, key=_by_moves, default=None)
    slow = configuration.timed[largest].median_ns if largest else math.inf
    return -right, -len(configuration.timed), slow, configuration.solver
