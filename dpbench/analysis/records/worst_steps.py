"""The hardest steps of a solver over all of its runs."""

import math
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.run_steps import MEASURES, Measure, RunSteps, find_hardest_steps
from dpbench.bench.judge.rules import median_of_known
from dpbench.bench.record.cell import Configuration


@dataclass(frozen=True)
class WorstStep:
    """A solver's step of largest error, time or iterations over all runs, with its run's median.

    value, median : of the measure, at the step and over its run: ns, iterations, or an error.
    """

    measure: Measure
    run: RunRecord
    step: RunSteps
    value: float
    median: float

    @property
    def step_index(self) -> int:
        """Index k within its run of a solver's worst step by time, iterations or error."""
        return int(self.step.k[0])

    @property
    def export_command(self) -> str:
        """Shell command that writes the worst step's QP and certified optimum to a file."""
        run = self.run
        k = self.step_index + run.first_step
        return f"dpbench export {run.export_argument} --at {k} --out worst-{self.measure}.npz"


def find_worst_steps(records: Records, solver: str) -> list[WorstStep]:
    """Return, over all runs, a solver's step of largest error, of largest time, of most iterations.

    It is one of its replays, whose QPs are those that `export` writes, or else of its loops.
    """
    runs = {run.run_id: run for run in records.runs if run.solver == solver}
    worst_of_run = {
        run_id: _find_worst_step_by_measure(runs[run_id], steps)
        for run_id, steps, _ in records.yield_merged_and_raw_steps(list(runs.values()))
    }
    stepped = [run_id for run_id in runs if run_id in worst_of_run]
    timed = [run_id for run_id in stepped if runs[run_id].mode == "replay"]
    worst: list[WorstStep] = []
    for measure in sorted(MEASURES, key=lambda name: name != "error"):
        of_runs = [worst_of_run[run_id] for run_id in timed or stepped]
        candidates = [of_run[measure] for of_run in of_runs if measure in of_run]
        if candidates:
            worst.append(max(candidates, key=lambda step: step.value))
    return worst


def _find_worst_step_by_measure(run: RunRecord, steps: RunSteps) -> dict[Measure, WorstStep]:
    """Return one run's step of largest error, of largest time, and of most iterations."""
    worst: dict[Measure, WorstStep] = {}
    for measure in MEASURES:
        at, values = find_hardest_steps(steps, measure, 1), steps.get_values_of_measure(measure)
        if len(at):
            value, usual = float(values[at[0]]), median_of_known(values)
            worst[measure] = WorstStep(measure, run, steps.select_steps(at), value, usual)
    return worst


def find_value_at_worst_step(
    records: Records, worst: WorstStep, configuration: Configuration
) -> float:
    """Return another configuration's time, iterations or error at a solver's worst step; or NaN."""
    place = worst.run.mode, worst.run.problem, worst.run.units
    for run in records.runs:
        same = (run.mode, run.problem, run.units) == place
        if not same or run.configuration.moved_to_common_formulation != configuration:
            continue
        for _, steps, _ in records.yield_merged_and_raw_steps([run]):
            at = np.flatnonzero(steps.k == worst.step_index)
            if len(at):
                return float(steps.get_values_of_measure(worst.measure)[at[0]])
    return math.nan
