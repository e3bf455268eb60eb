"""Allocations of a step and the memory of a process, against what is known to be allocated."""

import ctypes
import itertools
import math
import time
from typing import Any

import numpy as np
import pytest

from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.run import footprint
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram
from dpbench.solvers.calibration import COPY_ONLY, NO_OP, NoOpWorkspace, open_calibration_solver
from dpbench.solvers.contract import Workspace

MEGABYTE = 2**20


def _sequence(n: int = 3, steps: int = 12) -> QPSequence:
    one, many = np.ones(n), np.ones((steps, n))
    base = QuadraticProgram(np.eye(n), one, np.eye(n), -one, one, -one, one)
    return QPSequence("made up", base, many, -many, many)


def _measured(workspace: Workspace, n: int = 3) -> tuple[float, float, float]:
    made, formulated = formulate_sequence("condensed_box", _sequence(n))
    timed_solver = TimedSolver(workspace, formulated, time.perf_counter_ns)
    timed_solver.prepare()
    return footprint.measure_step_memory(made, timed_solver, 10)


def test_no_op_holds_nothing_and_copy_only_an_answer() -> None:
    idle, copied = (_measured(open_calibration_solver(name)) for name in (NO_OP, COPY_ONLY))
    assert (idle[0], copied[0]) == (0.0, 4.0)


def test_the_peak_within_a_step_holds_arrays_that_are_gone_after_it() -> None:
    class Spender(NoOpWorkspace):
        def solve(self) -> None:
            np.ones(MEGABYTE, dtype=np.uint8)

    blocks, peak, _ = _measured(Spender("spender"))
    assert blocks == 0.0
    assert MEGABYTE <= peak < MEGABYTE + 10_000


@pytest.mark.skipif(math.isnan(footprint.heap_bytes_in_use()), reason="glibc 2.33 shows its heap")
def test_a_library_that_leaks_is_seen() -> None:
    """5000 bytes of `malloc` a step that nobody frees: glibc rounds them up to 5008."""
    libc = ctypes.CDLL(None)
    libc.malloc.restype = ctypes.c_void_p
    libc.malloc.argtypes = [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]
    lost = np.zeros(100, dtype=np.uint64)
    calls = itertools.count()

    class Leaker(NoOpWorkspace):
        def update(self, step: QPStep) -> None:
            lost[next(calls)] = libc.malloc(5000)

    _, _, growth = _measured(Leaker("leaker"))
    for address in lost.tolist():
        libc.free(address)
    assert 5000 <= growth < 5100


def test_nothing_is_measured_without_a_step() -> None:
    log = RawLog.in_memory(make_replay_layout(2, 30, 3, 3))
    log.times[:] = -1
    assert footprint.count_affordable_steps(log) == 30
    log.times[1, 7, 3] = 10_000_000
    assert footprint.count_affordable_steps(log) == 5, (
        "a fifth of a second in four passes of 10 ms steps"
    )
    log.times[1, 7, 3] = 2_000_000_000
    assert footprint.count_affordable_steps(log) == 0
    timed_solver: Any = None
    assert all(
        math.isnan(value) for value in footprint.measure_step_memory(_sequence(), timed_solver, 0)
    )


def test_peak_memory_counts_the_solver_and_not_the_log() -> None:
    """64 MB that the solver takes and gives back count; 32 MB of QPs and the log do not."""
    watch = footprint.MemoryWatch()
    watch.record_memory_after_setup()
    log = RawLog.in_memory(make_replay_layout(1, 2, 2 * MEGABYTE // 4, 1))
    held = np.ones(8 * MEGABYTE // 2, dtype=np.float64)
    watch.record_memory_after_loading(log)
    before = watch.peak_bytes()
    spent = np.ones(8 * MEGABYTE, dtype=np.float64)
    size = spent.nbytes
    del spent
    assert watch.peak_bytes() - before == pytest.approx(size, abs=2 * MEGABYTE)
    assert held[0] == 1.0 and before < 4 * MEGABYTE


def test_threads_are_counted() -> None:
    running, allowed = footprint.count_own_and_library_threads()
    assert running >= 1 and allowed >= 1


@pytest.mark.slow
def test_a_later_replay_of_a_process_counts_its_own_memory() -> None:
    log = RawLog.in_memory(make_replay_layout(1, 2, 1, 1))
    memory = footprint.MemoryWatch()
    memory.record_memory_after_setup()
    memory.record_memory_after_loading(log)
    left = np.ones(64 * MEGABYTE, dtype=np.uint8)
    assert memory.peak_bytes() > 60 * MEGABYTE
    memory.begin_replay()
    memory.record_memory_after_setup()
    memory.record_memory_after_loading(log)
    assert memory.peak_bytes() < 32 * MEGABYTE
    taken = np.ones(128 * MEGABYTE, dtype=np.uint8)
    assert 96 * MEGABYTE < memory.peak_bytes() < 160 * MEGABYTE
    assert left.any() and taken.any()
