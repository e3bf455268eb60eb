"""Tolerances of the harness's own configurations, and a quick run of all of them."""

import gc
import os
from dataclasses import dataclass

import numpy as np

from dpbench.bench.judge.rules import mask_disturbed_rounds
from dpbench.bench.record.disturbance import Disturbance, compute_disturbance_metrics
from dpbench.bench.record.raw_log import RawLog, sum_phases_by_step_ns
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_sequence_solver_and_log, clock
from dpbench.bench.run.replay import ReplayRun
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.solvers.calibration import CALIBRATION, NO_OP, WAITS_NS, open_calibration_solver

BAR_NS, BAR_SHARE = 1000.0, 0.01
"""A known wait is measured within either of them; doing nothing takes at most the first."""
_SIZE, _STEPS, _ROUNDS = 15, 200, 5
"""Size of the paper's QP; together a second and a half of waiting."""


def compute_excess_over_wait_ns(configuration: str, p50_ns: float) -> float:
    """Return by how much a measured median exceeds the known wait of a dummy solver [ns]."""
    return p50_ns - WAITS_NS.get(configuration, 0)


def is_within_tolerance(configuration: str, p50_ns: float) -> bool | None:
    """Return whether a dummy solver's measured median is right; None if its time is not known."""
    if configuration not in WAITS_NS and configuration != NO_OP:
        return None
    return abs(compute_excess_over_wait_ns(configuration, p50_ns)) <= max(
        BAR_NS, BAR_SHARE * WAITS_NS.get(configuration, 0)
    )


@dataclass(frozen=True)
class Calibration:
    """Median step times of dummy solvers of known duration [ns], and the machine's disturbance."""

    p50_ns: dict[str, float]
    disturbance: Disturbance


def time_dummy_solvers() -> Calibration:
    """Time every dummy solver on this process's last core; return medians and disturbance."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    collecting = gc.isenabled()
    gc.disable()
    try:
        runs = {name: _time_dummy_solver(name) for name in CALIBRATION}
    finally:
        os.sched_setaffinity(0, allowed)
        if collecting:
            gc.enable()
    medians = {name: p50 for name, (p50, _) in runs.items()}
    return Calibration(medians, Disturbance.from_parts([part for _, part in runs.values()]))


def _build_sequence() -> QPSequence:
    """Return a sequence of made-up QPs to time dummy solvers with, which do not solve them."""
    eye, zero = np.eye(_SIZE), np.zeros(_SIZE)
    base = QuadraticProgram(eye, zero, eye, zero - 1, zero + 1, zero - 1, zero + 1)
    many = np.zeros((_STEPS, _SIZE))
    return QPSequence("made up", base, many, many - 1, many + 1)


def _time_dummy_solver(name: str) -> tuple[float, Disturbance]:
    """Replay made-up QPs with a dummy solver; return its median step time [ns] and disturbance."""
    steps, timed_solver, log = build_sequence_solver_and_log(
        _build_sequence(), open_calibration_solver(name), "condensed_box", _ROUNDS, RawLog.in_memory
    )
    replaying = ReplayRun(
        steps, timed_solver, log, warmup_steps=_STEPS, limit_ns=NO_LIMIT_NS, clock=clock
    )
    replaying.run_all_rounds()
    slowed = mask_disturbed_rounds(log.reference_kernel_ns)[1:]  # the warm-up does not count
    seen = compute_disturbance_metrics(log)
    return float(np.median(sum_phases_by_step_ns(log.times[1:]))), Disturbance(
        rounds=_ROUNDS,
        disturbed=float(slowed.sum()),
        rerun=0.0,
        seconds=seen["replay_s"],
        involuntary=seen["involuntary_switches"],
        steal_s=seen["steal_s"],
        throttled=seen["throttle_events"],
    )
