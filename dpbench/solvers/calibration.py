"""Calibration workloads: workspaces of a known cost, which solve nothing.

    no_op              every method returns at once, `read` the same stored object: the harness
    copy_only          `update` copies q, l, u, `read` copies an answer out: the contract
    busy_wait_<t>us    `solve` waits for t µs: checks the measurement of a known time

They run through the same path as every solver, but are neither judged nor ranked. Their cost is
printed and subtracted nowhere.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import (
    NO_PROJECT_FACTS,
    RouteRecord,
    SolverRecord,
    Workspace,
    check_step,
    make_error_for_missing_setup,
)

NO_OP, COPY_ONLY = "no_op", "copy_only"
WAITS_NS = {f"busy_wait_{wait}us": 1000 * wait for wait in (5, 20, 50, 200, 1000)}
"""Waiting time by name [ns]."""

# The raw clock, where there is one, is independent of the harness's own, so that it checks it.
_steady_ns: Callable[[], int] = (
    partial(time.clock_gettime_ns, time.CLOCK_MONOTONIC_RAW)
    if hasattr(time, "CLOCK_MONOTONIC_RAW")
    else time.perf_counter_ns
)


def _make_calibration_solver_record(name: str, method: str) -> SolverRecord:
    """Return the record of a calibration solver, which has no library."""
    return SolverRecord(
        name=name,
        family="harness",
        method=method,
        distribution="",
        module="",
        extra="own",
        form="dense",
        routes={
            "native": RouteRecord(
                ("reuse",),
                gives_multipliers=False,
                detects_infeasibility=False,
                refused={"fresh": "the solver has nothing to set up", "warm": "it has no start"},
            )
        },
        levels={},
        project=NO_PROJECT_FACTS,
    )


CALIBRATION: dict[str, SolverRecord] = {
    NO_OP: _make_calibration_solver_record(NO_OP, "none: every method returns at once"),
    COPY_ONLY: _make_calibration_solver_record(
        COPY_ONLY, "none: copies q, l, u in and an answer out"
    ),
    **{
        n: _make_calibration_solver_record(n, f"none: waits {ns // 1000} µs in solve")
        for n, ns in WAITS_NS.items()
    },
}
"""Records of the calibration solvers by name, in the order of display; none is a solver of the
table."""


class NoOpWorkspace(Workspace):
    """A dummy solver that does nothing, to measure the time the benchmark itself takes."""

    def __init__(self, solver: str) -> None:
        super().__init__(solver, "native", "reuse")
        self._answer: Solution | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Store an answer without numbers, of the problem's size."""
        self._answer = Solution.without_point(qp.n, qp.m, Status.UNKNOWN)

    def update(self, step: QPStep) -> None:
        """Do nothing with the vectors of the next QP."""

    def solve(self) -> None:
        """Do nothing: a dummy solver that takes no time."""

    def read(self) -> Solution:
        """Return the stored answer without numbers."""
        if self._answer is None:
            raise make_error_for_missing_setup("read")
        return self._answer


class BusyWaitWorkspace(NoOpWorkspace):
    """A dummy solver whose solve takes `wait_ns` [ns], to test the time measurement."""

    def __init__(self, solver: str, wait_ns: int, clock: Callable[[], int] = _steady_ns) -> None:
        super().__init__(solver)
        self._wait_ns, self._clock = wait_ns, clock

    def solve(self) -> None:
        """Wait `wait_ns` on the clock, without solving."""
        clock = self._clock
        over = clock() + self._wait_ns
        while clock() < over:
            pass


class CopyOnlyWorkspace(Workspace):
    """A dummy solver that copies vectors in and an empty answer out, to time the copies."""

    def __init__(self, solver: str) -> None:
        super().__init__(solver, "native", "reuse")
        self._size: tuple[int, int] | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Allocate and store buffers for q, l, u and the answer."""
        self._size = qp.n, qp.m
        self.q, self.l, self.u = qp.q.copy(), qp.l.copy(), qp.u.copy()
        self._z, self._y = np.full(qp.n, np.nan), np.full(qp.m, np.nan)

    def update(self, step: QPStep) -> None:
        """Check the shapes of q, l, u and store copies of them."""
        if self._size is None:
            raise make_error_for_missing_setup("update")
        check_step(step, *self._size)
        self.q[:] = step.q
        self.l[:] = step.l
        self.u[:] = step.u

    def solve(self) -> None:
        """Do nothing, as a solver that only copies data."""

    def read(self) -> Solution:
        """Return a copy of an answer without numbers."""
        if self._size is None:
            raise make_error_for_missing_setup("read")
        return Solution(Status.UNKNOWN, self._z.copy(), self._y.copy(), self._z.copy())


def open_calibration_solver(name: str) -> Workspace:
    """Return a dummy solver, to test time measurement: no_op, copy_only, busy_wait_<t>us."""
    if name in WAITS_NS:
        return BusyWaitWorkspace(name, WAITS_NS[name])
    return NoOpWorkspace(name) if name == NO_OP else CopyOnlyWorkspace(name)
