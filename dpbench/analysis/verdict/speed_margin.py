"""Speed margins: how much slower a computer may be, from steps timed several times.

Two limits bound it: the deadline, for the hardest step of all replays, and the limit of the p99.
Both times are the fastest round of a step, the work of the solver: that grows with the slowness of
a computer, an interrupt does not. Stalls are reported apart, as measured.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.records.run_steps import RunSteps
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.time_findings import compute_p99_ns
from dpbench.bench.record.cell import Configuration


@dataclass(frozen=True)
class SlowStep:
    """Step whose solve time limits how slow a computer may be.

    time_ns : its algorithmic time; k : the sample of the scenario.
    iterations : the solver's own count, NaN without one; n_active : active limits at the optimum.
    """

    time_ns: float
    run: RunRecord
    k: int
    iterations: float
    n_active: float


@dataclass(frozen=True)
class SpeedMargin:
    """Largest slow-down of a computer at which a solver passes, and the steps that limit it.

    hardest : the step with the largest algorithmic time.
    p99 : the step whose time is the largest p99 of all replays; the hardest step where none
        supports a p99.
    deadline, p99_limit : factors until the hardest step takes the deadline, and until the p99
        reaches its limit.
    """

    hardest: SlowStep
    p99: SlowStep
    deadline: float
    p99_limit: float

    @property
    def allowed_slowness_factor(self) -> float:
        """Factor by which a computer may be slower with p99 and deadline still kept."""
        return min(self.deadline, self.p99_limit)


@lru_cache(maxsize=2)
def compute_speed_margins(
    records: Records, requirements: Requirements
) -> Mapping[Configuration, SpeedMargin]:
    """Compute, for each timed configuration, how much slower a computer may be."""
    replays = [run for run in records.select_runs(mode="replay", units="scaled") if run.has_steps]
    of_configuration = group_by_key(
        replays, lambda run: run.configuration.moved_to_common_formulation
    )
    bounds: dict[Configuration, tuple[RunRecord, RunRecord]] = {}
    for configuration, runs in of_configuration.items():
        algo = {
            run: times.algo_ns for run in runs if (times := records.get_step_times(run)) is not None
        }
        if algo:
            hardest = max(algo, key=lambda run: float(algo[run].max()))
            p99 = {run: compute_p99_ns(run, algo[run]) for run in algo}
            known = [run for run in algo if not math.isnan(p99[run])]
            bounds[configuration] = hardest, max(known, key=lambda run: p99[run], default=hardest)
    steps = _find_longest_and_p99_steps(
        records, {run.run_id: run for both in bounds.values() for run in both}
    )
    margins = {}
    for configuration, (slowest, at_p99) in bounds.items():
        step, p99_step = steps[slowest.run_id][0], steps[at_p99.run_id][1]
        factors = requirements.deadline_ns / step.time_ns, requirements.p99_ns / p99_step.time_ns
        margins[configuration] = SpeedMargin(step, p99_step, *factors)
    return margins


def _find_longest_and_p99_steps(
    records: Records, runs: Mapping[str, RunRecord]
) -> dict[str, tuple[SlowStep, SlowStep]]:
    """Return by run the step with the largest time, and the one nearest to the p99."""
    found: dict[str, tuple[SlowStep, SlowStep]] = {}
    for run_id, steps, _ in records.yield_merged_and_raw_steps(list(runs.values())):
        run, largest = runs[run_id], float(np.nanmax(steps.time_ns))
        p99 = compute_p99_ns(run, steps.time_ns)
        times_ns = largest, largest if math.isnan(p99) else p99
        found[run_id] = (
            _find_step_nearest_to_time(run, steps, times_ns[0]),
            _find_step_nearest_to_time(run, steps, times_ns[1]),
        )
    return found


def _find_step_nearest_to_time(run: RunRecord, steps: RunSteps, time_ns: float) -> SlowStep:
    """Return a run's step whose solve time is nearest to `time_ns`, labelled with `time_ns`."""
    at = int(np.nanargmin(np.abs(steps.time_ns - time_ns)))
    k = run.first_step + int(steps.k[at])
    return SlowStep(time_ns, run, k, float(steps.iterations[at]), float(steps.n_active[at]))


def find_largest_stall_ns(records: Records) -> float:
    """Return the longest delay by the machine in runs of the test solvers [ns]; or NaN."""
    arms = [run for run in records.calibration if run.mode == "replay"]
    delays = records.read_delays_by_run(arms).values()
    stalls = [float((one.delay_ns - one.own_ns).max()) for one in delays if len(one.delay_ns)]
    return max(stalls, default=math.nan)
