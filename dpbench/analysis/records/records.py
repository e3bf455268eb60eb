"""Records of one result folder: runs by topic, and the step times of a replay."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import pandas as pd

from dpbench.analysis.records.loop_ratios import (
    SOLVE_TIME_COLUMNS,
    compare_loops_over_replayed_steps,
)
from dpbench.analysis.records.run_record import RunRecord, build_run_records, map_first_by_key
from dpbench.analysis.records.run_steps import (
    COUNTING_COLUMNS,
    TIME_COLUMNS,
    Delays,
    RunSteps,
    StepTimes,
    extract_counting_rows,
    yield_delays_by_run,
    yield_merged_steps_by_run,
    yield_step_times_by_run,
)
from dpbench.analysis.records.untimed_iterations import relate_replays_to_closed_loops
from dpbench.bench.judge.rules import has_comparable_times, mask_failed_steps
from dpbench.bench.record.cell import COMMON_FORMULATION
from dpbench.bench.record.recorded_steps import ALL_COLUMNS, find_row_ranges_by_label
from dpbench.bench.record.result_folder import Results, SuiteDescription
from dpbench.bench.record.schema import STEP_COLUMNS, convert_to_columns
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents
from dpbench.solvers.calibration import CALIBRATION

FAILURE_COLUMNS = ("run_id", "k", "certificate", "status", "fallback", "unconverged")
INACCURACY_COLUMNS = ("k", "error_move")


def find_inaccurate_steps(steps: pd.DataFrame, limit: float) -> tuple[int, int]:
    """Return how many steps of one run have a first move's error above a limit, and the first.

    A step counts if it is inaccurate in any round, warm-up and disturbed rounds included, as in
    `error_move_max`. steps : the run's step rows with `INACCURACY_COLUMNS`. The first is −1
    without any.
    """
    k = steps["k"][steps["error_move"] > limit]
    return k.nunique(), int(k.min()) if len(k) else -1


class FailedSteps(NamedTuple):
    """Steps that fail in any round of a run.

    status : that of most; first : the first of them; infeasible : those whose QP is infeasible.
    """

    steps: int
    status: str
    first: int
    infeasible: int = 0


NO_FAILED_STEPS = FailedSteps(0, "", -1)


class Records:
    """All runs of one result folder, grouped by subject, with access to their steps and times.

    Steps are read when needed: those of many runs by `yield_step_tables`, those of one by
    `read_step_table`. Each of `all_runs` is in one of: `runs`, about the ship in the common
    formulation of their problem, from which all selections below are made; `delayed`, loops on a
    slow computer; `random`, without a ship; `consequence`, whether a loss can be held; `at_edge`,
    static allocations around a capability plot; `study`, one scenario at many points, those of
    equal settings once, under the name that `study_aliases` has for the others; or in none, of
    another formulation. The harness's own configurations are in `calibration` only. A replay that
    must not be ranked has no times.
    """

    def __init__(self, results: Results) -> None:
        self.machine, self.suite = results.machine, results.suite
        every = build_run_records(results.runs, _list_study_keys(self.suite))
        runs = [
            run if self.has_comparable_times(run) else run.copy_without_times() for run in every
        ]
        self.calibration = [run for run in runs if run.solver in CALIBRATION]
        runs = [run for run in runs if run.solver not in CALIBRATION]
        # What a solver is judged on is not for the random problems to say.
        routes = _map_default_route_by_solver(runs) | _map_default_route_by_solver(
            [run for run in runs if not run.is_outside_verdicts]
        )
        self.all_runs = [
            replace(run, default_route=True) if run.route == routes[run.solver] else run
            for run in runs
        ]
        self._steps = results.recorded
        self.all_runs = relate_replays_to_closed_loops(self.all_runs)
        if self.has_steps:
            self.all_runs = compare_loops_over_replayed_steps(
                self.all_runs, lambda run: self.read_counting_step_table(run, SOLVE_TIME_COLUMNS)
            )
        self.delayed = [run for run in self.all_runs if run.slowdown > 0.0]
        self.random = [run for run in self.all_runs if run.family]
        self.consequence = [run for run in self.all_runs if run.lost_thruster_group]
        self.at_edge = [run for run in self.all_runs if run.is_at_boundary]
        studied = [run for run in self.all_runs if run.study]
        measured = map_first_by_key(studied, lambda run: run.measurement_key)
        self.study = list(measured.values())
        names = {run.solver_label: measured[run.measurement_key].solver_label for run in studied}
        self.study_aliases = {alias: name for alias, name in names.items() if alias != name}
        undelayed = [run for run in self.all_runs if not run.slowdown > 0.0]
        self.runs = _select_runs_in_common_formulation(
            [run for run in undelayed if not run.is_outside_verdicts]
        )
        self._times: dict[str, StepTimes | None] = {}
        self._delays: dict[str, Delays] = {}
        self._scenarios: dict[str, Scenario | None] = {}

    @property
    def has_steps(self) -> bool:
        """True if the folder has `steps.parquet`; one sent to others has none."""
        return self._steps.rows > 0

    def read_step_table(self, run: RunRecord, columns: Sequence[str] = ALL_COLUMNS) -> pd.DataFrame:
        """Return the table of a run's steps with the given columns; empty without steps."""
        if not self.has_steps:
            return convert_to_columns(
                pd.DataFrame(), {name: STEP_COLUMNS[name] for name in columns}
            )
        return self._steps.read_run(run.run_id, columns)

    def read_counting_step_table(
        self, run: RunRecord, columns: Sequence[str] = ALL_COLUMNS
    ) -> pd.DataFrame:
        """Return a run's step table without warm-up and disturbed repetitions."""
        steps = self.read_step_table(run, tuple(dict.fromkeys([*columns, "counts"])))
        return steps[steps["counts"]]

    def yield_step_tables(
        self, runs: Sequence[RunRecord], columns: Sequence[str]
    ) -> Iterator[pd.DataFrame]:
        """Yield the step rows of given runs from file, in tables of some hundred thousand rows."""
        wanted = {run.run_id for run in runs if run.has_steps}
        return self._steps.scan(columns, wanted) if wanted else iter(())

    def yield_merged_and_raw_steps(
        self, runs: Sequence[RunRecord], columns: Sequence[str] = ()
    ) -> Iterator[tuple[str, RunSteps, pd.DataFrame]]:
        """Yield per run its id, its steps merged over repetitions, and the unmerged step rows."""
        asked = tuple(dict.fromkeys([*COUNTING_COLUMNS, *columns]))
        for table in self.yield_step_tables(runs, asked):
            rows, places = table[list(columns)], find_row_ranges_by_label(table["run_id"])
            for run_id, steps in yield_merged_steps_by_run(extract_counting_rows(table)):
                first, end = places[run_id]
                yield run_id, steps, rows.iloc[first:end]

    @cached_property
    def failed_steps_by_run(self) -> dict[str, FailedSteps]:
        """The steps that fail in any round of a run, by run id."""
        found: dict[str, FailedSteps] = {}
        failing = [run for run in self.runs if run.failed_steps > 0]
        for table in self.yield_step_tables(failing, FAILURE_COLUMNS):
            failed = table[mask_failed_steps(table)]
            for run_id, steps in failed.groupby("run_id", observed=True):
                k, status = steps["k"], str(steps["status"].mode()[0])
                infeasible = k[steps["certificate"] == "infeasible"].nunique()
                found[str(run_id)] = FailedSteps(k.nunique(), status, int(k.min()), infeasible)
        return found

    def find_inaccurate_steps(self, run: RunRecord, limit: float) -> tuple[int, int]:
        """Return `find_inaccurate_steps` of a run; (0, −1) where the folder has no steps."""
        return find_inaccurate_steps(self.read_step_table(run, INACCURACY_COLUMNS), limit)

    def select_runs(self, **wanted: object) -> list[RunRecord]:
        """Return the runs of this folder whose columns equal given values, or one of a tuple."""
        allowed = {name: v if isinstance(v, tuple) else (v,) for name, v in wanted.items()}
        return [
            run for run in self.runs if all(getattr(run, name) in v for name, v in allowed.items())
        ]

    @cached_property
    def solvers(self) -> list[str]:
        """Names of the solvers in the order of the suite, without the law that solves no QP."""
        return list(dict.fromkeys(r.solver for r in self.all_runs if not r.is_baseline_law))

    @cached_property
    def scenarios(self) -> list[str]:
        """Names of all scenarios in this folder's runs, in the order of the suite."""
        return list(dict.fromkeys(run.scenario for run in self.runs))

    def count_steps_of_longest_loop(self, scenario: str) -> int:
        """Return the number of steps of a scenario's longest planned closed loop; or 0."""
        loops = self.select_runs(mode="closed_loop", scenario=scenario)
        return max((run.steps_planned for run in loops), default=0)

    @cached_property
    def sequences(self) -> list[str]:
        """Names of the replayed QP sequences in the order of the suite."""
        replays = (
            run for run in self.select_runs(mode="replay") if not run.steps_searched_for_hardest
        )
        return list(dict.fromkeys(run.sequence for run in replays))

    def select_replays(self, sequence: str, **wanted: object) -> list[RunRecord]:
        """Return the replays of a QP sequence in scaled units whose columns have given values."""
        return self.select_runs(mode="replay", sequence=sequence, units="scaled", **wanted)

    def has_comparable_times(self, run: RunRecord) -> bool:
        """Return whether a run's step times may be compared with those of other runs."""
        of_folder = str(self.machine.get("id", ""))
        return run.mode != "replay" or has_comparable_times(
            run.concurrency, run.machine_id, of_folder
        )

    def get_step_times(self, run: RunRecord) -> StepTimes | None:
        """Return a replay's step times; None without a valid step or if not comparable."""
        if not self.has_comparable_times(run):
            return None
        if not self._times:
            runs = (*self.calibration, *self.all_runs)
            self._read_and_cache_times(
                [run for run in runs if run.mode == "replay" and not run.family]
            )
        if run.run_id not in self._times:
            self._read_and_cache_times([run])
        return self._times[run.run_id]

    def _read_and_cache_times(self, runs: Sequence[RunRecord]) -> None:
        """Store in these records the step times of given replays, read from file."""
        self._times |= dict.fromkeys(run.run_id for run in runs)
        for table in self.yield_step_tables(runs, TIME_COLUMNS):
            self._times |= dict(yield_step_times_by_run(table))

    def read_delays_by_run(self, runs: Sequence[RunRecord]) -> dict[str, Delays]:
        """Return unusually long step timings of given runs, by run id."""
        unread = [run for run in runs if run.run_id not in self._delays]
        for table in self.yield_step_tables(unread, TIME_COLUMNS):
            self._delays |= dict(yield_delays_by_run(table))
        return {run.run_id: self._delays[run.run_id] for run in runs if run.run_id in self._delays}

    def build_scenario(self, name: str) -> Scenario | None:
        """Return the named scenario, built from its recorded documents; None without them."""
        if name not in self._scenarios:
            carried = (run.scenario_documents for run in self.runs if run.scenario == name)
            files = next(filter(None, carried), None)
            self._scenarios[name] = None if files is None else build_scenario_from_documents(files)
        return self._scenarios[name]


def _list_study_keys(suite: SuiteDescription) -> list[str]:
    """Return the keys of `product` and `zip` of a suite's studies in the order of the suite."""
    tables = suite.get("study", [])
    return [key for t in tables for key in (*t.get("product", {}), *t.get("zip", {}))]


def _map_default_route_by_solver(runs: Sequence[RunRecord]) -> dict[str, str]:
    """Return the interface by which each solver is judged: qpsolvers, else the first recorded."""
    routes: dict[str, str] = {}
    for run in runs:
        if run.solver not in routes or run.route == "qpsolvers":
            routes[run.solver] = run.route
    return routes


def _select_runs_in_common_formulation(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """Return the runs in the common QP formulation, and those of the law that solves no QP.

    Where a problem was never run in `COMMON_FORMULATION`, its first formulation is the common one.
    """
    common: dict[tuple[str, ...], str] = {}
    for run in runs:
        problem = _get_problem_columns(run)
        if not run.is_baseline_law and (
            problem not in common or run.formulation == COMMON_FORMULATION
        ):
            common[problem] = run.formulation
    return [
        r for r in runs if r.is_baseline_law or r.formulation == common[_get_problem_columns(r)]
    ]


def _get_problem_columns(run: RunRecord) -> tuple[str, ...]:
    """Return the values that identify a run's problem: mode, scenario, QP sequence, units."""
    return run.mode, run.scenario, run.sequence, run.units
