"""Findings on the times of a configuration: replays, closed loops, single timings, speed margins.

Two limits bound the speed margin, how much slower a computer may be: the deadline, for the hardest
step of all replays, and the limit of the p99. Both times are the fastest round of a step, the work
of the solver: that grows with the slowness of a computer, an interrupt does not. Stalls are
reported apart, as measured.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from dpbench.analysis.records.machine import compute_round_spread
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.records.run_steps import RunSteps, StepTimes
from dpbench.analysis.statistics import UNKNOWN, Interval, estimate_percentile_interval
from dpbench.analysis.verdict.lateness import (
    LateTimings,
    Uncertainty,
    estimate_uncertainty,
    find_late_timings,
    read_delays,
    waits_for_threads,
)
from dpbench.analysis.verdict.requirements import (
    Cause,
    Doubt,
    Finding,
    Near,
    Requirements,
    make_finding_on_worst_runs,
)
from dpbench.arrays import Floats
from dpbench.bench.judge.rules import has_enough_samples_for_percentile, percentile_or_nan
from dpbench.bench.record.cell import Configuration

LOOP_TIMINGS = 200
"""Timings of a closed loop from which its median is a plain answer."""
ENOUGH_TIMINGS = 3
"""Timings of a step from which one interrupt of the machine is not its fastest. A replay has fewer
where its suite asks for fewer, a time limit stops it, or disturbed rounds do not count."""
HIDDEN = 1.1
"""Processor time of other threads over that of the timed calls from which work is hidden: a library
that solves in a thread of its own stays below 1."""
SHORTEST_S = 1e-3
"""Time of all timed calls below which the processor time of other threads is compared with this
one: two clocks that are read in turn differ by some 25 µs a round."""


@lru_cache(maxsize=2)
def find_late_timings_and_uncertainty(
    records: Records, requirements: Requirements
) -> tuple[Mapping[str, Sequence[LateTimings]], Uncertainty]:
    """Return a folder's solver calls that took too long, by run, and the times' uncertainty."""
    uncertainty = estimate_uncertainty(records)
    return find_late_timings(records, requirements, uncertainty), uncertainty


def find_slow_loops(
    records: Records,
    runs: Sequence[RunRecord],
    requirements: Requirements,
    uncertainty: Uncertainty,
) -> list[Finding]:
    """Return findings on closed loops whose median solve time is near or over the p99 limit.

    Late beyond its uncertainty, with and without the waits for the core; borderline within. The
    median needs `LOOP_TIMINGS` to be late.
    """
    order: tuple[Cause | Doubt | Near, ...]
    order = ("slow loop", "short slow loop", "loop waits", "loop borderline")
    kinds: dict[Cause | Doubt | Near, list[RunRecord]] = {kind: [] for kind in order}
    loops = [run for run in runs if run.mode == "closed_loop" and not run.slowdown > 0.0]
    delays = read_delays(records, loops)
    own_ns = {run_id: own.net_step_ns for run_id, own in delays.items() if own.has_waits}
    for run in loops:
        limit_ns, factor = requirements.p99_ns, uncertainty.get_factor_of_run(run)
        is_short = run.steps_done < LOOP_TIMINGS
        high_ns = limit_ns if is_short else factor * limit_ns
        if run.raw_p50_ns > high_ns and own_ns.get(run.run_id, math.inf) <= high_ns:
            kinds["loop waits"].append(run)
        elif run.raw_p50_ns > high_ns:
            kinds["short slow loop" if is_short else "slow loop"].append(run)
        elif run.raw_p50_ns >= limit_ns / factor:
            kinds["loop borderline"].append(run)
    findings = [
        finding
        for kind, of_kind in kinds.items()
        for finding in make_finding_on_worst_runs(kind, of_kind, lambda run: run.raw_p50_ns)
    ]
    return [
        replace(
            f,
            limit=requirements.p99_ns,
            factor=uncertainty.get_factor_of_run(f.runs[0]),
            machine=own_ns[f.runs[0].run_id] if f.kind == "loop waits" else math.nan,
        )
        for f in findings
    ]


def find_work_in_other_threads(runs: Sequence[RunRecord]) -> list[Finding]:
    """Return findings on runs whose solver computed more in other threads than in timed calls.

    A worker has one core. Windows are left out: steps solved before each round would count.
    """
    long = (run for run in runs if not run.steps_searched_for_hardest)
    hidden = [run for run in long if _compute_other_threads_share(run) > HIDDEN]
    return make_finding_on_worst_runs("hidden work", hidden, _compute_other_threads_share)


def _compute_other_threads_share(run: RunRecord) -> float:
    """Return the processor time of a run's other threads over that of its timed calls."""
    return run.thread_s / max(run.solve_s, SHORTEST_S)


_DOUBTFUL: Mapping[str, Doubt] = {
    "late timings": "perhaps late timings",
    "past the deadline": "perhaps past the deadline",
    "late at random": "late at random",
}
"""Findings on late timings that prove no miss of the requirements."""


def convert_late_timings_to_findings(
    runs: Sequence[RunRecord], late: Mapping[str, Sequence[LateTimings]]
) -> list[Finding]:
    """Return findings on late timings for a verdict, the worst run of each kind first."""
    found = [one for run in runs for one in late.get(run.run_id, ())]
    by_kind: dict[Cause | Doubt, list[LateTimings]] = group_by_key(found, _choose_cause_or_doubt)
    findings = []
    for kind, of_kind in by_kind.items():
        worst, *others = sorted(of_kind, key=lambda one: -one.late_share)
        at = (worst.run, *(one.run for one in others))
        findings.append(Finding(kind, at, worst.late_share, worst.samples, worst.machine))
    return findings


def _choose_cause_or_doubt(one: LateTimings) -> Cause | Doubt:
    """Return the kind of finding on late timings: a cause where they are proven, else a doubt."""
    if one.is_disturbed:
        return "late when disturbed"
    return one.kind if one.is_proven_late else _DOUBTFUL[one.kind]


def judge_replay_times(
    records: Records,
    replays: Sequence[RunRecord],
    requirements: Requirements,
    uncertainty: Uncertainty,
) -> tuple[list[Finding], dict[str, Any]]:
    """Return findings on replays' step times by the limits, and the percentiles by name."""
    findings: list[Finding] = []
    figures: list[_ReplayTimes] = []
    for run in replays:
        if run.caching_sign is not None:
            findings.append(Finding("remembered", (run,)))
        if not records.has_comparable_times(run):
            findings.append(Finding("not alone", (run,)))
            continue
        times = records.get_step_times(run)
        if times is not None:
            figures.append(_ReplayTimes.from_replay(records, run, times))
            findings += _compare_with_limits(
                figures[-1], requirements, uncertainty.get_factor_of_run(run)
            )
        elif run.outcome == "finished":
            findings.append(Finding("no step", (run,)))
    if not figures:
        return findings, {}
    whole = [one for one in figures if not one.run.steps_searched_for_hardest] or figures
    whole = [one for one in whole if one.run.has_all_steps]
    known = [one for one in whole if math.isfinite(one.algo.p99_ns)]
    by_time = (lambda one: one.algo.p99_ns) if known else (lambda one: one.algo.p50_ns)
    worst = max(known or whole, key=by_time, default=None)
    limiting = max(figures, key=lambda one: np.nan_to_num(one.bound_ns))
    is_measured = limiting.bound_ns == limiting.algo.p99_ns
    longest = max(figures, key=lambda one: one.longest_ns)
    return findings, {
        **(worst.of_sequence if worst else {}),
        "p99_ns": limiting.bound_ns,
        "p99_interval": _estimate_p99_interval_ns(records, limiting.run)
        if is_measured
        else UNKNOWN,
        "p99_wait_ns": _find_wait_at_p99_ns(records, limiting.run),
        "p99_run": limiting.run,
        "disturbed_spread": max(one.disturbed_spread for one in figures),
        "longest_ns": longest.longest_ns,
        "longest_run": longest.run,
        "raw_max_ns": max(one.raw_max_ns for one in figures),
        "of_sequences": {one.run.sequence: one.of_sequence for one in whole},
    }


def _estimate_p99_interval_ns(records: Records, run: RunRecord) -> Interval:
    """Return a replay's p99 step time with its 95 % interval [ns]; UNKNOWN of a window."""
    times = records.get_step_times(run)
    if times is None or run.steps_searched_for_hardest:
        return UNKNOWN
    return estimate_percentile_interval(times.algo_ns, 99)


def _find_wait_at_p99_ns(records: Records, run: RunRecord) -> float:
    """Return the wait for the core in the step whose time is nearest a replay's p99 [ns]."""
    times = records.get_step_times(run)
    if times is None:
        return 0.0
    return float(times.wait_ns[np.abs(times.algo_ns - compute_p99_ns(run, times.algo_ns)).argmin()])


def compute_p99_ns(run: RunRecord, algo_ns: Floats) -> float:
    """Return a replay's p99 step time, of each step's fastest repetition [ns], or NaN.

    Of a window, one in a hundred steps of its stretch exceeds it if those beyond are all in the
    window; see `untimed_iterations.py` for how far they are not.
    """
    if not run.steps_searched_for_hardest:
        return percentile_or_nan(algo_ns, 99)
    beyond = math.floor(0.01 * run.steps_searched_for_hardest)
    return float(np.sort(algo_ns)[::-1][min(beyond, len(algo_ns) - 1)])


def find_own_times_ns(run: RunRecord, times: StepTimes) -> Floats:
    """Return the parts of a replay's step times (K,) that other programs cannot have caused [ns].

    Where waits for the core are recorded, these are the times without them. Otherwise they are the
    algorithmic times; of fewer than `ENOUGH_TIMINGS` timings, each of so many of the slowest steps
    as context switches can have hit in every timing counts with the median.
    """
    if times.net_ns is not None and not waits_for_threads(run, int(times.timings.sum())):
        return times.net_ns
    timings = int(np.median(times.timings))
    if timings >= ENOUGH_TIMINGS:
        return times.algo_ns
    # A round that a time limit stopped has no count of its switches.
    switches = run.involuntary_switches if run.outcome == "finished" else math.nan
    own = np.sort(times.algo_ns)
    # `max` returns 0 where the switches are unknown.
    own[math.ceil(max(0.0, len(own) - switches / timings)) :] = np.median(own)
    return own


@dataclass(frozen=True)
class _Percentiles:
    """Median, p95, p99 and maximum of step times [ns]; NaN for too few steps."""

    p50_ns: float
    p95_ns: float
    p99_ns: float
    max_ns: float

    @classmethod
    def of(cls, run: RunRecord, times_ns: Floats) -> "_Percentiles":
        """Return the percentiles of a replay's step times (K,) [ns]."""
        p95, p99 = percentile_or_nan(times_ns, 95), compute_p99_ns(run, times_ns)
        return cls(float(np.median(times_ns)), p95, p99, float(times_ns.max()))

    @property
    def high_ns(self) -> float:
        """The p99 step time [ns], or the p95 where there are too few steps for it."""
        return self.p95_ns if math.isnan(self.p99_ns) else self.p99_ns


@dataclass(frozen=True)
class _ReplayTimes:
    """Percentiles of one replay's step times, and those that the solver itself caused for sure.

    timings : of the median step; disturbed_spread : see `compute_round_spread`.
    hardest_net_ns : time of the hardest step less the wait of that timing, where it is known.
    """

    run: RunRecord
    algo: _Percentiles
    own: _Percentiles
    has_waits: bool
    raw_max_ns: float
    rounds_ns: tuple[float, float]
    disturbed_spread: float
    timings: int
    steps: int
    hardest_net_ns: float

    @classmethod
    def from_replay(cls, records: Records, run: RunRecord, times: StepTimes) -> "_ReplayTimes":
        """Return the percentiles and extremes of one replay's step times."""
        own_ns = find_own_times_ns(run, times)
        return cls(
            run,
            _Percentiles.of(run, times.algo_ns),
            _Percentiles.of(run, own_ns),
            own_ns is times.net_ns,
            times.raw_max_ns,
            (float(times.rounds_ns.min()), float(times.rounds_ns.max())),
            compute_round_spread(records, run, times),
            int(np.median(times.timings)),
            len(times.k),
            float(times.algo_ns.max()) - times.hardest_wait_ns,
        )

    @property
    def longest_ns(self) -> float:
        """Time of the longest step [ns], scaled up to the closed loop's iterations."""
        return self.algo.max_ns * self.run.untimed_iterations_max

    @property
    def of_sequence(self) -> dict[str, Any]:
        """Fields of a verdict that is `timed_on` this replay."""
        return {
            "p50_ns": self.algo.p50_ns,
            "timed_on": self.run.sequence,
            "rounds_ns": self.rounds_ns,
            "iterations": (self.run.iterations_p50, self.run.iterations_max),
            "replay_p99_ns": self.algo.p99_ns,
            "raw_p99_ns": self.run.raw_p99_ns,
        }

    @property
    def has_p50(self) -> bool:
        """Return whether all steps were timed, and enough of them for a p50."""
        is_enough = has_enough_samples_for_percentile(self.steps, 50)
        return self.run.has_all_steps and is_enough

    @property
    def bound_ns(self) -> float:
        """The p99 [ns], as much longer as the closed loop has more iterations than the replay."""
        return self.algo.p99_ns * self.run.untimed_iterations

    def doubt(self, waits: Doubt, few: Doubt, time_ns: float, own_ns: float) -> Finding:
        """Return the finding on a time beyond a limit that other programs may have caused."""
        if self.has_waits:
            return Finding(waits, (self.run,), time_ns, machine=own_ns)
        return Finding(few, (self.run,), time_ns, self.timings)


def _compare_with_limits(
    figures: _ReplayTimes, requirements: Requirements, factor: float
) -> list[Finding]:
    """Return findings on a replay's times that are beyond p99 limit or deadline, or near.

    A time is late if the solver's own part of it is beyond the limit, too: see `find_own_times_ns`.
    Single timings are tested against the machine in `lateness.py`.
    """
    found = (
        (
            _compare_with_deadline(figures, requirements.deadline_ns, factor),
            requirements.deadline_ns,
        ),
        (_compare_with_p99_limit(figures, requirements.p99_ns, factor), requirements.p99_ns),
    )
    return [replace(f, limit=limit, factor=factor) for f, limit in found if f is not None]


def _compare_with_deadline(figures: _ReplayTimes, limit_ns: float, factor: float) -> Finding | None:
    """Return the finding on a replay's hardest step that is beyond the deadline, or near."""
    longest_ns, net_ns = figures.algo.max_ns, figures.hardest_net_ns
    if figures.own.max_ns <= factor * limit_ns < longest_ns:
        return figures.doubt("deadline waits", "few deadline timings", longest_ns, net_ns)
    if longest_ns < limit_ns / factor:
        # Nothing passes with a speed margin below 1.
        bound_ns = figures.longest_ns
        if bound_ns > limit_ns:
            return Finding("longest step untimed", (figures.run,), bound_ns, machine=longest_ns)
        return None
    kind: Cause | Near = (
        "deadline late" if longest_ns > factor * limit_ns else "deadline borderline"
    )
    return Finding(kind, (figures.run,), longest_ns)


def _compare_with_p99_limit(
    figures: _ReplayTimes, limit_ns: float, factor: float
) -> Finding | None:
    """Return the finding on a replay's p99, or p95, that is beyond the limit, or near."""
    run, algo, own = (figures.run,), figures.algo, figures.own
    low_ns, high_ns = limit_ns / factor, limit_ns * factor
    if own.high_ns <= high_ns < algo.high_ns:
        kinds: tuple[Doubt, Doubt] = "p99 waits", "few timings"
        if math.isnan(algo.p99_ns):
            kinds = "p95 waits", "few p95 timings"
        return figures.doubt(*kinds, algo.high_ns, own.high_ns)
    if algo.p99_ns > high_ns:
        kind: Cause = "window late" if figures.run.steps_searched_for_hardest else "p99 late"
        return Finding(kind, run, algo.p99_ns)
    if algo.p99_ns >= low_ns:
        return Finding("p99 borderline", run, algo.p99_ns)
    # Nothing passes with a speed margin below 1.
    if figures.bound_ns > limit_ns:
        return Finding("slow steps untimed", run, figures.bound_ns, machine=algo.p99_ns)
    if not math.isnan(algo.p99_ns):
        return None
    is_p95 = not (math.isnan(algo.p95_ns) and figures.has_p50)
    time_ns, own_ns = (algo.p95_ns, own.p95_ns) if is_p95 else (algo.p50_ns, own.p50_ns)
    if own_ns > high_ns:
        return Finding("p95 late" if is_p95 else "p50 late", run, time_ns)
    if limit_ns < time_ns <= high_ns:
        return Finding("p95 uncertain" if is_p95 else "p50 uncertain", run, time_ns)
    if algo.max_ns > limit_ns:
        net_ns = figures.hardest_net_ns
        return Finding("no p99", run, algo.max_ns, figures.steps, machine=net_ns)
    return Finding("p95 borderline", run, algo.p95_ns) if algo.p95_ns >= low_ns else None


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
    """Largest slowdown of a computer at which a solver passes, and the steps that limit it.

    hardest : the step with the largest algorithmic time, scaled up to the largest number of
        iterations of the closed loop.
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
    def limiting_p99_ns(self) -> float:
        """The p99 that limits the speed margin [ns], scaled up to the closed loop's iterations."""
        return self.p99.time_ns * self.p99.run.untimed_iterations

    @property
    def longest_ns(self) -> float:
        """The time of the hardest step [ns], scaled up to the closed loop's iterations."""
        return self.hardest.time_ns * self.hardest.run.untimed_iterations_max

    @property
    def allowed_slowness_factor(self) -> float:
        """Factor by which a computer may be slower with p99 and deadline still kept."""
        return min(self.deadline, self.p99_limit)


@lru_cache(maxsize=4)
def compute_speed_margins(
    records: Records, requirements: Requirements, *, of_thrusters: bool = False
) -> Mapping[Configuration, SpeedMargin]:
    """Return, by timed configuration, how much slower a computer may be; empty without limits.

    of_thrusters : whether only replays count in which the MPC commands thrusters.
    """
    if not requirements.judges_step_times:
        return {}
    replays = [
        run
        for run in records.select_runs(mode="replay", units="scaled")
        if run.has_steps and (run.commands_thrusters or not of_thrusters)
    ]
    of_configuration = group_by_key(
        replays, lambda run: run.configuration.moved_to_common_formulation
    )
    bounds: dict[Configuration, tuple[RunRecord, RunRecord]] = {}
    for configuration, runs in of_configuration.items():
        algo = {
            run: times.algo_ns for run in runs if (times := records.get_step_times(run)) is not None
        }
        if algo:
            longest = {run: float(algo[run].max()) * run.untimed_iterations_max for run in algo}
            hardest = max(longest, key=longest.__getitem__)
            p99 = {run: compute_p99_ns(run, algo[run]) * run.untimed_iterations for run in algo}
            known = [run for run in algo if not math.isnan(p99[run])]
            bounds[configuration] = hardest, max(known, key=lambda run: p99[run], default=hardest)
    steps = _find_longest_and_p99_steps(
        records, {run.run_id: run for both in bounds.values() for run in both}
    )
    margins = {}
    for configuration, (slowest, at_p99) in bounds.items():
        step, p99_step = steps[slowest.run_id][0], steps[at_p99.run_id][1]
        bounds_ns = (
            step.time_ns * slowest.untimed_iterations_max,
            p99_step.time_ns * at_p99.untimed_iterations,
        )
        factors = requirements.deadline_ns / bounds_ns[0], requirements.p99_ns / bounds_ns[1]
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
