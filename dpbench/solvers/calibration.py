"""The harness's own solvers: workspaces of a known cost, which solve nothing.

    no_op              every method returns at once, `read` the same stored object: the harness
    copy_only          `update` copies q, l, u, `read` copies an answer out: the contract
    busy_wait_<t>us    `solve` waits for t µs: whether the harness measures what is known

They run through the same path as every solver, and their answers are no answers: nobody judges or
ranks them. What they cost is printed and subtracted nowhere.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Workspace, check_step, missing_setup_error
from dpbench.solvers.record import NO_PROJECT_FACTS, RouteRecord, SolverRecord

NO_OP, COPY_ONLY = "no_op", "copy_only"
WAITS_NS = {f"busy_wait_{wait}us": 1000 * wait for wait in (5, 20, 50, 200, 1000)}
"""What each that waits does so for [ns]."""

# Waiting is the only work in `solvers` that reads a clock. The raw clock, where there is one, is
# another than the harness's own, so that one checks the other.
_steady_ns: Callable[[], int] = (
    partial(time.clock_gettime_ns, time.CLOCK_MONOTONIC_RAW)
    if hasattr(time, "CLOCK_MONOTONIC_RAW")
    else time.perf_counter_ns
)


def _record(name: str, method: str) -> SolverRecord:
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
                refused={"fresh": "it has nothing to set up", "warm": "it has no start"},
            )
        },
        levels={},
        project=NO_PROJECT_FACTS,
    )


CALIBRATION: dict[str, SolverRecord] = {
    NO_OP: _record(NO_OP, "none: every method returns at once"),
    COPY_ONLY: _record(COPY_ONLY, "none: copies q, l, u in and an answer out"),
    **{n: _record(n, f"none: waits {ns // 1000} µs in solve") for n, ns in WAITS_NS.items()},
}
"""By name, in the order they are shown; none of them is a solver of the table."""


class NoOp(Workspace):
    """Methods that do nothing; the answer is one stored object without a number in it."""

    def __init__(self, solver: str) -> None:
        super().__init__(solver, "native", "reuse")
        self._answer: Solution | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Store the answer that is none."""
        self._answer = Solution.missing(qp.n, qp.m, Status.UNKNOWN)

    def update(self, step: QPStep) -> None:
        """Nothing."""

    def solve(self) -> None:
        """Nothing."""

    def read(self) -> Solution:
        """Return the stored object: unlike a solver's, not in memory of its own."""
        if self._answer is None:
            raise missing_setup_error("read")
        return self._answer


class BusyWait(NoOp):
    """Waits `wait_ns` by `clock` [ns] in `solve`, without giving the core away."""

    def __init__(self, solver: str, wait_ns: int, clock: Callable[[], int] = _steady_ns) -> None:
        super().__init__(solver)
        self._wait_ns, self._clock = wait_ns, clock

    def solve(self) -> None:
        """Read the clock until the time is over."""
        clock = self._clock
        over = clock() + self._wait_ns
        while clock() < over:
            pass


class CopyOnly(Workspace):
    """What the contract asks of any workspace, and nothing else."""

    def __init__(self, solver: str) -> None:
        super().__init__(solver, "native", "reuse")
        self._size: tuple[int, int] | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Own buffers for the vectors in, and for the answer out."""
        self._size = qp.n, qp.m
        self.q, self.l, self.u = qp.q.copy(), qp.l.copy(), qp.u.copy()
        self._z, self._y = np.full(qp.n, np.nan), np.full(qp.m, np.nan)

    def update(self, step: QPStep) -> None:
        """Check the shapes and copy q, l, u."""
        if self._size is None:
            raise missing_setup_error("update")
        check_step(step, *self._size)
        self.q[:] = step.q
        self.l[:] = step.l
        self.u[:] = step.u

    def solve(self) -> None:
        """Nothing."""

    def read(self) -> Solution:
        """Copy an answer that is none."""
        if self._size is None:
            raise missing_setup_error("read")
        return Solution(Status.UNKNOWN, self._z.copy(), self._y.copy(), self._z.copy())


def open_calibration(name: str) -> Workspace:
    """Open the workspace of one of `CALIBRATION`."""
    if name in WAITS_NS:
        return BusyWait(name, WAITS_NS[name])
    return NoOp(name) if name == NO_OP else CopyOnly(name)
