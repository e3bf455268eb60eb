"""The bars of the harness's own configurations, and its quick run on a simulated clock."""

import gc
import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dpbench.bench.judge import calibration
from dpbench.bench.judge.calibration import (
    compute_excess_over_wait_ns,
    is_within_tolerance,
    time_dummy_solvers,
)
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.replay import ReplayRun
from dpbench.qp.program import QPSequence
from dpbench.solvers.calibration import CALIBRATION, NO_OP
from dpbench.solvers.open import open_workspace

READING_NS = 3
"""Time of each reading of the simulated clock."""


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[RawLog]:
    """Only `no_op` is calibrated, by a clock that advances at each reading; the logs so far."""
    now = 0

    def read() -> int:
        nonlocal now
        now += READING_NS
        return now

    logs: list[RawLog] = []
    in_memory = RawLog.in_memory

    def kept(layout: dict[str, tuple[str, tuple[int, ...]]]) -> RawLog:
        logs.append(in_memory(layout))
        return logs[-1]

    monkeypatch.setattr(RawLog, "in_memory", kept)
    monkeypatch.setattr(calibration, "clock", read)
    monkeypatch.setattr("dpbench.bench.run.assemble.clock", read)
    monkeypatch.setattr(calibration, "CALIBRATION", {NO_OP: CALIBRATION[NO_OP]})
    return logs


@pytest.mark.parametrize(
    ("name", "wait_ns", "bar_ns"),
    [(NO_OP, 0, 1000), ("busy_wait_50us", 50_000, 1000), ("busy_wait_1000us", 1_000_000, 10_000)],
)
def test_the_bar_is_a_microsecond_or_a_hundredth(name: str, wait_ns: int, bar_ns: int) -> None:
    assert is_within_tolerance(name, float(wait_ns)) is True
    assert compute_excess_over_wait_ns(name, wait_ns + 300.0) == 300.0
    for side in (-1, 1):
        assert is_within_tolerance(name, wait_ns + side * bar_ns) is True
        assert is_within_tolerance(name, wait_ns + side * (bar_ns + 0.01)) is False
    assert (
        is_within_tolerance("copy_only", 1e9) is None
        and compute_excess_over_wait_ns("copy_only", 1e9) == 1e9
    )


def test_a_quick_calibration_times_the_rounds_after_the_warm_up(clock: list[RawLog]) -> None:
    found = time_dummy_solvers()
    (log,) = clock
    assert log.done.tolist() == [200] * 6 and log.z.shape == (6, 200, 15)
    assert found.p50_ns[NO_OP] % READING_NS == 0
    assert READING_NS <= found.p50_ns[NO_OP] <= 5 * READING_NS


def test_made_up_qps_have_a_solution(clock: list[RawLog], monkeypatch: pytest.MonkeyPatch) -> None:
    """Dummy solvers do not solve them, but any solver could: ½‖z‖² in all limits is least at 0."""
    seen: list[QPSequence] = []
    assemble = calibration.build_sequence_solver_and_log

    def parts(sequence: QPSequence, *others: Any) -> Any:
        seen.append(sequence)
        return assemble(sequence, *others)

    monkeypatch.setattr(calibration, "build_sequence_solver_and_log", parts)
    time_dummy_solvers()
    (sequence,) = seen
    base = sequence.base
    assert (base.n, base.m, len(sequence)) == (15, 15, 200)
    for qp in (base, base.at(sequence.step(0)), base.at(sequence.step(199))):
        workspace = open_workspace("quadprog", route="native", policy="fresh")
        workspace.setup(qp)
        workspace.solve()
        assert not workspace.read().z.any()
        assert (qp.lb < 0).all() and (qp.l < 0).all() and (qp.u > 0).all() and (qp.ub > 0).all()


def test_median_of_counted_rounds(clock: list[RawLog], monkeypatch: pytest.MonkeyPatch) -> None:
    """A warm-up of 1 s a step and rounds of 1, 2, 4, 8 and 16 ns a step have a median of 4.

    Kernels of 9 (the warm-up), 4, 4, 6, 6 and 4: beyond 1.25 times the best are two rounds.
    """

    def rounds(self: ReplayRun) -> None:
        log = clock[-1]
        log.times[:] = -1
        log.times[:, :, 3] = np.array([10**9, 1, 2, 4, 8, 16])[:, None]
        log.reference_kernel_ns[:] = np.array([9.0, 4.0, 4.0, 6.0, 6.0, 4.0])[:, None]
        log.done[:] = 200
        log.attempts[:] = 1
        log.counters[:] = np.arange(6.0)[:, None] * [1.0, 0.0, 10.0, 0.5, 0.0, 0.0]
        log.counters[0] = 1e6

    monkeypatch.setattr(ReplayRun, "run_all_rounds", rounds)
    found = time_dummy_solvers()
    assert found.p50_ns == {NO_OP: 4.0}
    seen = found.disturbance
    assert (seen.rounds, seen.disturbed, seen.rerun) == (5, 2.0, 0.0)
    assert (seen.seconds, seen.involuntary, seen.steal_s, seen.throttled) == (15.0, 150.0, 7.5, 0.0)


@pytest.mark.parametrize("collecting", [True, False])
@pytest.mark.parametrize("breaks", [True, False])
def test_process_restored(collecting: bool, breaks: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    cores, seen = os.sched_getaffinity(0), []

    def replayed(name: str) -> object:
        seen.append((os.sched_getaffinity(0), gc.isenabled()))
        if breaks:
            raise RuntimeError("planted")
        return quiet()

    quiet = _quiet()
    monkeypatch.setattr(calibration, "_time_dummy_solver", replayed)
    was_collecting = gc.isenabled()
    (gc.enable if collecting else gc.disable)()
    try:
        if breaks:
            with pytest.raises(RuntimeError, match="planted"):
                time_dummy_solvers()
        else:
            assert set(time_dummy_solvers().p50_ns) == set(CALIBRATION)
        assert (os.sched_getaffinity(0), gc.isenabled()) == (cores, collecting)
        assert set(map(str, seen)) == {str(({max(cores)}, False))}
    finally:
        (gc.enable if was_collecting else gc.disable)()


def _quiet() -> Callable[[], object]:
    """A replay of 1 ns a step that nothing disturbed."""
    nothing = dict.fromkeys(("disturbed", "rerun", "seconds", "involuntary"), 0.0)
    undisturbed = calibration.Disturbance(rounds=1, steal_s=0.0, throttled=0.0, **nothing)
    return lambda: (1.0, undisturbed)
