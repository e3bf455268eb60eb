"""Findings on the times of a configuration: replays, closed loops and single timings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.verdict.findings import Cause, Doubt, Finding, Near, finding_on_worst
from dpbench.analysis.verdict.lateness import LateTimings, find_late_timings
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.uncertainty import Uncertainty, estimate_uncertainty
from dpbench.arrays import Floats
from dpbench.bench.judge.rules import percentile_or_nan

LOOP_TIMINGS = 200
"""Timings of a closed loop from which its median is a plain answer."""
ENOUGH_TIMINGS = 3
"""Timings of a step from which one interrupt of the machine is not its fastest; a replay gets so
many rounds unless its time limit stops it."""
HIDDEN = 1.1
"""Processor time of other threads over that of the timed calls from which work is hidden: a library
that solves in a thread of its own stays below 1."""
SHORTEST_S = 1e-3
"""Time of all timed calls below which the processor time of other threads is compared with this
one: two clocks that are read in turn differ by some 25 µs a round."""


@lru_cache(maxsize=2)
def late_timing_evidence(
    records: Records, requirements: Requirements
) -> tuple[Mapping[str, Sequence[LateTimings]], Uncertainty]:
    """Return a folder's solver calls that took too long, by run, and the times' uncertainty."""
    uncertainty = estimate_uncertainty(records)
    return find_late_timings(records, requirements, uncertainty), uncertainty


def find_slow_loops(
    runs: Sequence[RunRecord], requirements: Requirements, uncertainty: Uncertainty
) -> list[Finding]:
    """Find closed loops whose median solve time is near or beyond the limit on the p99.

    Late beyond its uncertainty, borderline within; the median needs `LOOP_TIMINGS` to be late.
    """
    order: tuple[Cause | Doubt | Near, ...] = ("slow loop", "short slow loop", "loop borderline")
    kinds: dict[Cause | Doubt | Near, list[RunRecord]] = {kind: [] for kind in order}
    for run in runs:
        if run.mode != "closed_loop" or run.slowdown > 0.0:
            continue
        ratio, factor = run.raw_p50_ns / requirements.p99_ns, uncertainty.of(run)
        if run.steps_done < LOOP_TIMINGS and ratio > 1.0:
            kinds["short slow loop"].append(run)
        elif ratio > factor:
            kinds["slow loop"].append(run)
        elif ratio >= 1.0 / factor:
            kinds["loop borderline"].append(run)
    return [
        finding
        for kind, of_kind in kinds.items()
        for finding in finding_on_worst(kind, of_kind, lambda run: run.raw_p50_ns)
    ]


def find_hidden_work(runs: Sequence[RunRecord]) -> list[Finding]:
    """Find runs whose solver computed more in other threads than in the timed calls.

    A worker has one core. Windows are left out: steps solved before each round would count.
    """
    long = (run for run in runs if not run.window_of)
    hidden = [run for run in long if _other_threads_share(run) > HIDDEN]
    return finding_on_worst("hidden work", hidden, _other_threads_share)


def _other_threads_share(run: RunRecord) -> float:
    """Return the processor time of a run's other threads over that of its timed calls."""
    return run.thread_s / max(run.solve_s, SHORTEST_S)


_DOUBTFUL: Mapping[str, Doubt] = {
    "late timings": "perhaps late timings",
    "past the deadline": "perhaps past the deadline",
    "late at random": "late at random",
}
"""Findings on late timings that prove no miss of the requirements."""


def report_late_timings(
    runs: Sequence[RunRecord], late: Mapping[str, Sequence[LateTimings]]
) -> list[Finding]:
    """Convert late timings of runs to findings for a verdict, the worst run of each kind first."""
    found = [one for run in runs for one in late.get(run.run_id, ())]
    by_kind: dict[Cause | Doubt, list[LateTimings]] = group_by(found, _choose_finding)
    findings = []
    for kind, of_kind in by_kind.items():
        worst, *others = sorted(of_kind, key=lambda one: -one.share)
        at = (worst.run, *(one.run for one in others))
        findings.append(Finding(kind, at, worst.share, worst.samples, worst.machine))
    return findings


def _choose_finding(one: LateTimings) -> Cause | Doubt:
    """Choose the finding on late timings: a cause where they are proven, else a doubt."""
    if one.is_disturbed:
        return "late when disturbed"
    return one.kind if one.is_proven else _DOUBTFUL[one.kind]


def judge_times(
    records: Records,
    replays: Sequence[RunRecord],
    requirements: Requirements,
    uncertainty: Uncertainty,
) -> tuple[list[Finding], dict[str, Any]]:
    """Judge replays' step times by the limits; return findings, and percentiles by name."""
    findings: list[Finding] = []
    figures: list[_ReplayTimes] = []
    for run in replays:
        if run.remembers:
            findings.append(Finding("remembered", (run,)))
        if not records.is_ranked(run):
            findings.append(Finding("not alone", (run,)))
            continue
        times = records.times(run)
        if times is not None:
            figures.append(_ReplayTimes.of(run, times))
            findings += _check_limits(figures[-1], times.algo_ns, requirements, uncertainty.of(run))
        elif run.outcome == "finished":
            findings.append(Finding("no step", (run,)))
    if not figures:
        return findings, {}
    whole = [one for one in figures if not one.run.window_of] or figures
    known = [one for one in whole if math.isfinite(one.p99_ns)]
    worst = max(known or whole, key=lambda one: one.p99_ns if known else one.p50_ns)
    p99 = max(figures, key=lambda one: np.nan_to_num(one.p99_ns))
    return findings, {
        "p50_ns": worst.p50_ns,
        "p99_ns": p99.p99_ns,
        "p99_run": p99.run,
        "timed_on": worst.run.sequence,
        "rounds_ns": worst.rounds_ns,
        "replay_p99_ns": worst.p99_ns,
        "raw_p99_ns": worst.run.raw_p99_ns,
        "algo_max_ns": max(one.max_ns for one in figures),
        "raw_max_ns": max(one.raw_max_ns for one in figures),
    }


def p99_ns(run: RunRecord, algo_ns: Floats) -> float:
    """Return a replay's p99 step time, of each step's fastest repetition [ns], or NaN.

    A window holds the hardest steps of a stretch, so those beyond the stretch's p99 are all in it.
    """
    if not run.window_of:
        return percentile_or_nan(algo_ns, 99)
    beyond = math.floor(0.01 * run.window_of)
    return float(np.sort(algo_ns)[::-1][min(beyond, len(algo_ns) - 1)])


@dataclass(frozen=True)
class _ReplayTimes:
    """Median, p95, p99 and maxima of one replay's step times [ns]; NaN if too few steps.

    timings : of the median step.
    """

    run: RunRecord
    p50_ns: float
    p95_ns: float
    p99_ns: float
    max_ns: float
    raw_max_ns: float
    rounds_ns: tuple[float, float]
    timings: int

    @classmethod
    def of(cls, run: RunRecord, times: StepTimes) -> _ReplayTimes:
        """Compute the percentiles and extremes of one replay's step times."""
        algo, rounds = times.algo_ns, times.rounds_ns
        p95, p99 = percentile_or_nan(algo, 95), p99_ns(run, algo)
        ends = float(rounds.min()), float(rounds.max())
        p50, timings = float(np.median(algo)), int(np.median(times.timings))
        return cls(run, p50, p95, p99, float(algo.max()), times.raw_max_ns, ends, timings)

    @property
    def is_cut(self) -> bool:
        """True if the run's time limit left most steps fewer than `ENOUGH_TIMINGS`."""
        return self.run.outcome == "timed_out" and self.timings < ENOUGH_TIMINGS


def _check_limits(
    figures: _ReplayTimes, algo_ns: Floats, requirements: Requirements, factor: float
) -> list[Finding]:
    """Compare a replay's times with p99 limit and deadline; return findings if late or near.

    Of a cut replay only the median proves a miss of the p99: a higher percentile may be the
    machine's. Its single timings are tested against the machine in `lateness.py`.
    """
    run, findings = (figures.run,), list[Finding]()
    if figures.max_ns > factor * requirements.deadline_ns:
        findings.append(Finding("deadline late", run, figures.max_ns))
    elif figures.max_ns >= requirements.deadline_ns / factor:
        findings.append(Finding("deadline borderline", run, figures.max_ns))
    limits = requirements.p99_ns / factor, requirements.p99_ns * factor
    high_ns = figures.p95_ns if math.isnan(figures.p99_ns) else figures.p99_ns
    if figures.is_cut and figures.p50_ns <= limits[1] < high_ns:
        findings.append(Finding("few timings", run, high_ns, figures.timings))
    elif figures.p99_ns > limits[1]:
        kind: Cause = "window late" if figures.run.window_of else "p99 late"
        findings.append(Finding(kind, run, figures.p99_ns))
    elif figures.p99_ns >= limits[0]:
        findings.append(Finding("p99 borderline", run, figures.p99_ns))
    elif not math.isnan(figures.p99_ns):
        return findings
    elif figures.p95_ns > limits[1]:
        findings.append(Finding("p95 late", run, figures.p95_ns))
    elif figures.max_ns > requirements.p99_ns:
        findings.append(Finding("no p99", run, figures.max_ns, len(algo_ns)))
    elif figures.p95_ns >= limits[0]:
        findings.append(Finding("p95 borderline", run, figures.p95_ns))
    return findings
