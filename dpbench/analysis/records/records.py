"""Look into the records: which runs belong to which question, and the step times of a replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import pandas as pd

from dpbench.analysis.records.counting_rows import CountingRows, counting_of
from dpbench.analysis.records.grouping import spans_of
from dpbench.analysis.records.run_record import RunRecord, records_of
from dpbench.analysis.records.step_times import StepTimes, step_times_of
from dpbench.bench.judge.rules import is_ranked
from dpbench.bench.record.configuration import COMMON
from dpbench.bench.record.result_folder import Results
from dpbench.scenario.scenario import Scenario, scenario_of
from dpbench.solvers.calibration import CALIBRATION


class Records:
    """The records of one result folder, asked by question.

    `all_runs`: each row is one of `runs`, which are about the ship, of `delayed`, closed loops on a
    slow computer, of `random`, which have no ship, of `consequence`, which ask whether a loss could
    be held, of `at_edge`, static allocations around a capability plot, of `study`, which steer one
    scenario at many points, or of another formulation than the common one of its problem; what is
    selected below is selected from `runs`, so that nothing mixes formulations, nor a solver's
    mistakes with a computer's. The harness's own configurations are no solvers: they are in
    `calibration` and nowhere else. A replay that must not be ranked has no times.
    """

    def __init__(self, results: Results) -> None:
        self.machine, self.suite = results.machine, results.suite
        runs = [
            run if self.is_ranked(run) else run.without_times() for run in records_of(results.runs)
        ]
        self.calibration = [run for run in runs if run.solver in CALIBRATION]
        runs = [run for run in runs if run.solver not in CALIBRATION]
        # What a solver is judged on is not for the random problems to say.
        routes = _default_routes(runs) | _default_routes([run for run in runs if not run.has_topic])
        self.all_runs = [
            replace(run, default_route=True) if run.route == routes[run.solver] else run
            for run in runs
        ]
        self.delayed = [run for run in self.all_runs if run.slowdown > 0.0]
        self.random = [run for run in self.all_runs if run.family]
        self.consequence = [run for run in self.all_runs if run.lost_group]
        self.at_edge = [run for run in self.all_runs if run.at_edge_of]
        self.study = [run for run in self.all_runs if run.study]
        undelayed = [run for run in self.all_runs if not run.slowdown > 0.0]
        self.runs = _commonly_formulated([run for run in undelayed if not run.has_topic])
        self._steps = results.steps
        self._times: dict[str, StepTimes | None] = {}
        self._scenarios: dict[str, Scenario | None] = {}

    @cached_property
    def _rows_of(self) -> dict[str, tuple[int, int]]:
        """First and last row of each run in the step table, which is ordered by run."""
        return spans_of(self._steps["run_id"])

    @property
    def has_steps(self) -> bool:
        """Whether the folder has the steps of its runs: what is sent to others has not."""
        return len(self._steps) > 0

    @cached_property
    def counting(self) -> CountingRows:
        """The rows of the step table that count, as arrays."""
        return counting_of(self._steps)

    def steps(self, run: RunRecord) -> pd.DataFrame:
        """The step rows of a run; empty when it left none."""
        first, last = self._rows_of.get(run.run_id, (0, 0))
        return self._steps.iloc[first:last]

    def counting_steps(self, *runs: RunRecord) -> pd.DataFrame:
        """The step rows of some runs that count."""
        steps = pd.concat([self._steps.iloc[:0], *map(self.steps, runs)])
        return steps[steps["counts"]]

    def select(self, **wanted: object) -> list[RunRecord]:
        """Runs whose columns have the wanted values, or one of a tuple of values."""
        return [
            run
            for run in self.runs
            if all(
                getattr(run, column) in value
                if isinstance(value, tuple)
                else getattr(run, column) == value
                for column, value in wanted.items()
            )
        ]

    @cached_property
    def solvers(self) -> list[str]:
        """The solvers that are ranked, in the order of the suite: all but the baseline law."""
        return list(dict.fromkeys(r.solver for r in self.all_runs if not r.is_baseline_law))

    @cached_property
    def scenarios(self) -> list[str]:
        """Scenarios in the order of the suite."""
        return list(dict.fromkeys(run.scenario for run in self.runs))

    def full_steps(self, scenario: str) -> int:
        """Steps of the longest closed loop of a scenario that the suite asks for; 0 if none."""
        loops = self.select(mode="closed_loop", scenario=scenario)
        return max((run.steps_planned for run in loops), default=0)

    def whole_steps(self, scenario: str) -> int:
        """Steps of the whole scenario; those the suite asks for where no row carries it."""
        carried = self.scenario(scenario)
        return self.full_steps(scenario) if carried is None else carried.steps

    def full_loops(self, scenario: str) -> list[RunRecord]:
        """Full-length closed loops of a scenario at default settings in scaled units, the baseline
        law included."""
        return self.select(
            mode="closed_loop",
            scenario=scenario,
            settings="default",
            units="scaled",
            steps_planned=self.full_steps(scenario),
        )

    @cached_property
    def sequences(self) -> list[str]:
        """Replayed sequences in the order of the suite."""
        return list(dict.fromkeys(run.sequence for run in self.select(mode="replay")))

    def replays(self, sequence: str, **wanted: object) -> list[RunRecord]:
        """Replays of a sequence in scaled units."""
        return self.select(mode="replay", sequence=sequence, units="scaled", **wanted)

    def is_ranked(self, run: RunRecord) -> bool:
        """Whether the times of a run may stand beside those of others; those of a loop never do."""
        of_folder = str(self.machine["id"])
        return run.mode != "replay" or is_ranked(run.concurrency, run.machine_id, of_folder)

    def times(self, run: RunRecord) -> StepTimes | None:
        """Step times of a replay; None when no counting round left a step, or it is not ranked."""
        if not self.is_ranked(run):
            return None
        if run.run_id not in self._times:
            self._times[run.run_id] = step_times_of(self.counting.of(run.run_id))
        return self._times[run.run_id]

    def scenario(self, name: str) -> Scenario | None:
        """The scenario a run was made from; None when no row carries it."""
        if name not in self._scenarios:
            files = (run.scenario_files for run in self.select(scenario=name))
            carried = next(filter(None, files), None)
            self._scenarios[name] = None if carried is None else scenario_of(carried)
        return self._scenarios[name]


def _default_routes(runs: Sequence[RunRecord]) -> dict[str, str]:
    """The route each solver is judged on: qpsolvers where it ran so, else its first one."""
    routes: dict[str, str] = {}
    for run in runs:
        if run.solver not in routes or run.route == "qpsolvers":
            routes[run.solver] = run.route
    return routes


def _commonly_formulated(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """The runs in the common formulation of their problem, and those of the baseline law.

    Where a problem was never run in `COMMON`, its first formulation is the common one.
    """
    common: dict[tuple[str, ...], str] = {}
    for run in runs:
        problem = _problem(run)
        if not run.is_baseline_law and (problem not in common or run.formulation == COMMON):
            common[problem] = run.formulation
    return [r for r in runs if r.is_baseline_law or r.formulation == common[_problem(r)]]


def _problem(run: RunRecord) -> tuple[str, ...]:
    return run.mode, run.scenario, run.sequence, run.units
