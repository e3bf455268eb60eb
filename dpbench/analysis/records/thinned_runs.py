"""Chosen steps: long runs thinned, with the ship's track; the hardest steps of a solver."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.run_steps import MEASURES, Measure, RunSteps, find_hardest_steps
from dpbench.arrays import Flags, Floats, Ints
from dpbench.bench.judge.rules import median_of_known
from dpbench.bench.record.cell import Configuration

TRACK = ("n_m", "e_m", "psi_rad")
FORCES = ("tau_x_N", "tau_y_N", "tau_n_Nm")


@dataclass(frozen=True, eq=False)
class Track:
    """Ship positions (N, 3) [m, m, rad] and forces (N, 3) as shares of limits, every n-th step."""

    every: int
    position: Floats
    force: Floats


class HardRow(NamedTuple):
    """One of a run's hardest steps: index, time or iterations or error, status, active limits."""

    k: int
    value: float
    status: str
    claimed: bool
    true: bool
    n_active: int

    @classmethod
    def from_step(cls, run: RunSteps, measure: Measure, i: int) -> "HardRow":
        """Return index, value of one measure, status and active limits of a run's step `i`."""
        answer = str(run.status[i]), bool(run.claimed[i]), bool(run.true[i]), int(run.n_active[i])
        return cls(int(run.k[i]), float(run.get_values_of_measure(measure)[i]), *answer)


@dataclass(frozen=True, eq=False)
class ThinnedRun:
    """Steps of a run thinned to what the report page has room for, the hardest included.

    steps : those that are kept; extra : (K,) which of them for being hard alone.
    last : the last step of the run, kept or not; is_whole : whether all are kept.
    hard : the hardest of all by each measure, the hardest first.
    track : None without a ship. inaccurate : how many steps of the run, kept or not, have an error
    above the limit, and the first; see `find_inaccurate_steps`.
    """

    steps: RunSteps
    extra: Flags
    last: int
    is_whole: bool
    hard: dict[Measure, list[HardRow]]
    track: Track | None
    inaccurate: tuple[int, int] = (0, -1)

    @classmethod
    def from_run(
        cls,
        run: RunSteps,
        most: int,
        track: Track | None = None,
        inaccurate: tuple[int, int] = (0, -1),
    ) -> "ThinnedRun":
        """Return a run thinned to about `most` steps: every n-th one and the hardest."""
        chosen, extra = choose_kept_indices_and_hard_flags(run, most)
        hard = {
            measure: [
                HardRow.from_step(run, measure, int(i)) for i in find_hardest_steps(run, measure)
            ]
            for measure in MEASURES
        }
        is_whole = len(chosen) == len(run.k)
        kept, last = run.select_steps(chosen), int(run.k[-1])
        return cls(kept, extra, last, is_whole, hard, track, inaccurate)


def thin_track(steps: pd.DataFrame, limits: Floats, most: int) -> Track:
    """Return a closed loop's ship positions and forces over limits, thinned to `most` points.

    limits : (3,) of the forces [N, N, N·m].
    """
    every = max(1, -(-len(steps) // most))

    def thin(names: Iterable[str]) -> Floats:
        return np.column_stack([steps[n].to_numpy(dtype=np.float64)[::every] for n in names])

    return Track(every, thin(TRACK), thin(FORCES) / limits)


WORST = 200
"""Number of hard steps that a thinned run keeps, at most a third of what is kept of it."""
MOST = 2000
"""Largest number of points of a run in a figure: four and more a pixel."""


def compute_common_length_limit(lengths: Sequence[int], most: int) -> int:
    """Return the largest cap for each of some lengths that keeps their sum within `most`."""
    shortest_first, rest = sorted(lengths), most
    for i, length in enumerate(shortest_first):
        share = rest // (len(shortest_first) - i)
        if length > share:
            return max(1, share)
        rest -= length
    return max(shortest_first, default=1)


def choose_kept_indices_and_hard_flags(run: RunSteps, most: int) -> tuple[Ints, Flags]:
    """Return about `most` step indices to keep, and which are kept only for being hard.

    Of a longer run every n-th stays, and of the rest the hardest by each measure and the first
    that were not reported as solved.
    """
    count = len(run.k)
    if count <= most:
        return np.arange(count), np.zeros(count, dtype=np.bool_)
    worst = min(WORST, most // 3)
    each = max(1, worst // (len(MEASURES) + 1))
    regular = np.arange(0, count, -(-count // max(1, most - worst)))
    hard = [find_hardest_steps(run, measure, each) for measure in MEASURES]
    both = np.union1d(regular, np.concatenate([*hard, np.flatnonzero(~run.claimed)[:each]]))
    return both, ~np.isin(both, regular)


def find_extreme_indices(values: Floats, most: int = MOST) -> Ints:
    """Return indices (M,) of at most `most` values to draw: least and largest of each section.

    A line of a few hundred pixels shows no difference.
    """
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // 2 + 1).astype(np.int64)
    known = np.nan_to_num(values)
    places = [
        a + extreme(known[a:b]) for a, b in pairwise(edges) for extreme in (np.argmin, np.argmax)
    ]
    return np.unique(places)


@dataclass(frozen=True)
class WorstStep:
    """A configuration's step of largest error, time or iterations, with its run's median.

    value, median : of the measure, at the step and over its run: ns, iterations, or an error.
    wait_ns : wait for the core in a largest time of a replay, which is chosen without it.
    """

    measure: Measure
    run: RunRecord
    step: RunSteps
    value: float
    median: float
    wait_ns: float = 0.0

    @property
    def step_index(self) -> int:
        """Index k of the worst step within its run."""
        return int(self.step.k[0])

    @property
    def scenario_step(self) -> int:
        """Number of the worst step in the scenario, of which a replay may be a range."""
        return self.run.first_step + self.step_index

    @property
    def export_command(self) -> str:
        """Shell command that writes the worst step's QP and certified optimum to a file.

        "" for a closed loop, as its QPs depend on the solver's own answers.
        """
        run = self.run
        if run.mode != "replay":
            return ""
        place = f"{run.export_argument} --at {self.scenario_step}"
        return f"dpbench export {place} --out worst-{self.measure}.npz"


def find_worst_steps(records: Records, configuration: Configuration) -> list[WorstStep]:
    """Return a configuration's steps of largest error, of largest time, of most iterations.

    Over its replays and closed loops in scaled units; times are of its replays if it has any. After
    a step of a closed loop comes the worst of the replays, whose QP `export` writes.
    """
    runs = {
        run.run_id: run
        for run in records.runs
        if run.units == "scaled" and run.configuration.moved_to_common_formulation == configuration
    }
    worst_of_run = {
        run_id: _find_worst_step_by_measure(records, runs[run_id], steps)
        for run_id, steps, _ in records.yield_merged_and_raw_steps(list(runs.values()))
    }
    stepped = sorted(worst_of_run, key=lambda run_id: runs[run_id].mode != "replay")
    timed = [run_id for run_id in stepped if runs[run_id].mode == "replay"]
    worst: list[WorstStep] = []
    for measure in sorted(MEASURES, key=lambda name: name != "error"):
        groups = [timed] if measure == "time" and timed else [stepped, timed]
        largest = {
            step.run.run_id: step
            for group in groups
            if (found := [worst_of_run[i][measure] for i in group if measure in worst_of_run[i]])
            for step in [max(found, key=lambda step: step.value - step.wait_ns)]
        }
        worst += largest.values()
    return worst


def _find_worst_step_by_measure(
    records: Records, run: RunRecord, steps: RunSteps
) -> dict[Measure, WorstStep]:
    """Return one run's step of largest error, of largest time, and of most iterations.

    The wait for the core is no time of the solver, so it does not choose the step.
    """
    worst: dict[Measure, WorstStep] = {}
    times = records.get_step_times(run) if run.mode == "replay" else None
    for measure in MEASURES:
        values, waits = steps.get_values_of_measure(measure), np.zeros(len(steps.k))
        if measure == "time" and times is not None:
            waits[np.searchsorted(steps.k, times.k)] = times.wait_ns
        if np.isfinite(values).any():
            at = int(np.nanargmax(values - waits))
            step, usual = steps.select_steps(np.array([at])), median_of_known(values)
            figures = float(values[at]), usual, float(waits[at])
            worst[measure] = WorstStep(measure, run, step, *figures)
    return worst


def find_value_at_worst_step(
    records: Records, worst: WorstStep, configuration: Configuration
) -> float:
    """Return another configuration's time, iterations or error at a worst step; or NaN.

    NaN for a closed loop, in which each solver has QPs of its own.
    """
    if worst.run.mode != "replay":
        return math.nan
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
