"""Solver releases compared: one configuration on one problem, version by version."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from packaging.version import InvalidVersion, Version

from dpbench.analysis.compare.pairs import ORDER, make_problem_key, pick_identifying_columns
from dpbench.analysis.compare.times import REFERENCES, make_usual_first_sort_key
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.bench.judge.rules import maximum_of_known
from dpbench.errors import InputError, UnknownNameError, format_allowed_names


@dataclass(frozen=True, eq=False)
class Release:
    """Runs and step times of one solver version on one problem in one configuration.

    runs : by the folder's name.
    p50, p99, largest : algorithmic step time, geometric mean over the folders, in ns or as
        multiples of the reference solver's p50 in the same folder; NaN where nothing was timed.
    """

    version: str
    runs: Mapping[str, RunRecord]
    p50: float
    p99: float
    largest: float

    @property
    def mean_load_test_ns(self) -> float:
        """Geometric mean time [ns] of the speed test that senses load, over the version's runs."""
        return _compute_geometric_mean([run.load_kernel_ns for run in self.runs.values()])

    @property
    def largest_error_move(self) -> float:
        """Largest error of the first control move over all runs of a solver version."""
        return maximum_of_known([run.error_move_max for run in self.runs.values()])

    @property
    def most_claimed_not_true_per_round(self) -> float:
        """Number of steps wrongly claimed solved, per repetition of a run; largest of all runs."""
        return maximum_of_known(
            [_divide_count_by_rounds(run, run.claimed_not_true) for run in self.runs.values()]
        )

    @property
    def most_failed_steps(self) -> float:
        """Number of failed steps; largest over a solver version's runs."""
        return maximum_of_known([run.failed_steps for run in self.runs.values()])

    @property
    def worst_outcome(self) -> str:
        """Worst outcome, from finished to crashed, of all runs of a solver version."""
        outcomes = {run.outcome for run in self.runs.values()}
        return max(outcomes, key=lambda one: ORDER.index(one) if one in ORDER else len(ORDER))


@dataclass(frozen=True, eq=False)
class History:
    """Versions of a solver in one configuration on one problem, the oldest first."""

    releases: Sequence[Release]

    @property
    def oldest_run(self) -> RunRecord:
        """One run of the oldest version, for what all versions share: solver, problem, settings."""
        return next(iter(self.releases[0].runs.values()))

    @property
    def has_several_versions(self) -> bool:
        """True if more than one version of the solver was run."""
        return len(self.releases) > 1

    def compute_time_ratio_to_previous(self, i: int) -> float:
        """Return the p50 step time of version i over that of the one before; NaN for the first."""
        return self.releases[i].p50 / self.releases[i - 1].p50 if i else math.nan

    @property
    def newest_to_oldest_time_ratio(self) -> float:
        """Ratio of p50 step times, the newest version over the oldest; NaN if untimed."""
        return self.releases[-1].p50 / self.releases[0].p50


@dataclass(frozen=True, eq=False)
class Histories:
    """Version histories of all solvers in several result folders, and the unit of their times.

    reference : the solver whose p50 is the unit of all times; "" where they are in ns.
    spread : largest ratio between two folders' p50 of one version: less is no change; NaN if
        unknown.
    alone : cells that only one of the folders has; folders : how many there are.
    """

    all: Sequence[History]
    reference: str
    spread: float
    alone: int
    folders: int


def compare_releases(folders: Mapping[str, Records], reference: str | None = None) -> Histories:
    """Return solver versions' step times and errors, per problem, over several result folders.

    Parameters
    ----------
    folders : by name.
    reference : the solver whose p50 divides all times. Folders of two machines always have one: by
        default the first of `times.REFERENCES` that all of them timed.

    Raises
    ------
    InputError : where a reference is needed and was not timed in all folders; where no two folders
        have a cell in common.
    """
    machines = {records.machine["id"] for records in folders.values()}
    solver = _choose_reference_solver(folders, reference) if reference or len(machines) > 1 else ""
    cells = _group_runs_by_problem_and_configuration(folders)
    common = {key: runs for key, runs in cells.items() if len(runs) > 1}
    if not common:
        allowed = "folders of the same suite"
        raise InputError("--releases", "", "no cell that two of the folders share", allowed)
    units = {
        name: _map_reference_times_by_problem(records, solver) for name, records in folders.items()
    }
    by_cell = [_build_version_history(runs, units) for runs in common.values()]
    by_cell.sort(
        key=lambda h: (
            h.oldest_run.solver,
            h.oldest_run.mode != "replay",
            make_usual_first_sort_key(h.oldest_run),
        )
    )
    ratios = []
    for release in (release for history in by_cell for release in history.releases):
        runs = release.runs.items()
        times = [_divide_time_by_reference(run, "algo_p50_ns", units[name]) for name, run in runs]
        if len(times) > 1 and all(map(math.isfinite, times)):
            ratios.append(max(times) / min(times))
    spread = max(ratios, default=math.nan)
    return Histories(by_cell, solver, spread, len(cells) - len(common), len(folders))


def _group_runs_by_problem_and_configuration(
    folders: Mapping[str, Records],
) -> dict[str, dict[str, RunRecord]]:
    """Return all folders' runs by problem and configuration, without lost, refused, slowed ones."""
    cells: dict[str, dict[str, RunRecord]] = {}
    for name, records in folders.items():
        for run in records.all_runs:
            if run.slowdown > 0.0 or run.is_baseline_law or run.outcome in ("lost", "refused"):
                continue
            cells.setdefault(repr((pick_identifying_columns(run), make_problem_key(run))), {})[
                name
            ] = run
    return cells


def _choose_reference_solver(folders: Mapping[str, Records], asked: str | None) -> str:
    """Return the name of the solver by whose median step time each folder's times are divided."""
    timed = [{run.solver for run in _yield_timed_replays(records)} for records in folders.values()]
    common = sorted(set.intersection(*timed))
    known = [name for name in ((asked,) if asked else REFERENCES) if name in common]
    if not known:
        found = repr(asked) if asked else f"none of {', '.join(REFERENCES)} in all folders"
        allowed = (
            format_allowed_names(asked or "", common)
            if common
            else "a solver that was replayed in all folders"
        )
        raise UnknownNameError("`reference`", "", found, allowed)
    return known[0]


def _yield_timed_replays(records: Records) -> Iterator[RunRecord]:
    """Yield the replays of a folder that have a median step time."""
    return (r for r in records.select_runs(mode="replay") if math.isfinite(r.algo_p50_ns))


def _map_reference_times_by_problem(
    records: Records, solver: str
) -> Mapping[tuple[str, str], float] | None:
    """Return the reference solver's p50 [ns] by problem and turns; None without a reference."""
    if not solver:
        return None
    runs = sorted(
        (r for r in _yield_timed_replays(records) if r.solver == solver),
        key=make_usual_first_sort_key,
        reverse=True,
    )
    return {(run.problem, run.turns): run.algo_p50_ns for run in runs}


def _build_version_history(
    runs: Mapping[str, RunRecord], units: Mapping[str, Mapping[tuple[str, str], float] | None]
) -> History:
    """Return the runs of one configuration on one problem by solver version, oldest first."""
    builds = len({run.build for run in runs.values()})

    def version_of(run: RunRecord) -> str:
        return f"{run.solver_version} {run.build if builds > 1 else ''}".strip() or "no version"

    releases = []
    for version, of_version in group_by_key(runs.items(), lambda item: version_of(item[1])).items():
        times = (
            _compute_geometric_mean(
                [_divide_time_by_reference(run, column, units[name]) for name, run in of_version]
            )
            for column in ("algo_p50_ns", "algo_p99_ns", "algo_max_ns")
        )
        releases.append(Release(version, dict(of_version), *times))
    return History(sorted(releases, key=lambda release: _make_version_sort_key(release.version)))


def _divide_time_by_reference(
    run: RunRecord, column: str, unit: Mapping[tuple[str, str], float] | None
) -> float:
    """Return a replay's step time [ns] or its ratio to the interleaved reference's; or NaN."""
    if run.mode != "replay":
        return math.nan  # loops run beside each other
    divisor = 1.0 if unit is None else unit.get((run.problem, run.turns), math.nan)
    return float(getattr(run, column)) / divisor


def _divide_count_by_rounds(run: RunRecord, count: float) -> float:
    """Return a count of a replay per round, where it has several rounds."""
    return count / run.rounds if run.rounds > 1.0 else count


def _make_version_sort_key(version: str) -> tuple[Any, ...]:
    """Return a sort key of a solver version: by number, texts without a number first."""
    try:
        return True, Version(version.partition(" ")[0]), version
    except InvalidVersion:
        return False, Version("0"), version


def _compute_geometric_mean(values: Sequence[float]) -> float:
    """Return the geometric mean of positive values."""
    return float(np.exp(np.mean(np.log(values))))


FIGURES = ("p50", "p99", "largest", "error")
"""Columns of a release in `tabulate_releases`: times in µs or multiples of the reference's, and
the error."""


def tabulate_releases(histories: Histories, most: int) -> pd.DataFrame:
    """Return a table of times and errors of solver versions on the first `most` problems.

    Its most usual configuration: a row per version, label, age (0 of the newest, else 1), problem
    and `FIGURES`.
    """
    chosen: dict[tuple[str, str], History] = {}
    for history in sorted(histories.all, key=lambda history: not history.has_several_versions):
        if history.oldest_run.mode == "replay" and math.isfinite(history.releases[0].p50):
            chosen.setdefault((history.oldest_run.problem, history.oldest_run.solver), history)
    problems = list(dict.fromkeys(problem for problem, _ in chosen))[:most]
    scale = 1.0 if histories.reference else 1e-3
    rows = [
        (
            f"{history.oldest_run.solver} {release.version}",
            0 if release is history.releases[-1] else 1,
            problem,
            *(scale * time for time in (release.p50, release.p99, release.largest)),
            release.largest_error_move,
        )
        for (problem, _), history in chosen.items()
        if problem in problems
        for release in history.releases
    ]
    return pd.DataFrame(rows, columns=["label", "age", "problem", *FIGURES])
