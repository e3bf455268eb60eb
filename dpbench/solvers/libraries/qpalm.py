"""QPALM through its own interface: two-sided, vectors updated, start given or cold."""

from __future__ import annotations

import scipy.sparse

from dpbench.arrays import Vector
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Start, stacked
from dpbench.solvers.record import RouteRecord
from dpbench.solvers.through_qpsolvers import qpalm as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse", "warm"),
    updates="vectors",
    start="primal and dual",
    two_sided=True,
    faults={
        "solved despite limits that cross": "its update does not look for them, its setup does"
    },
)

STATUS = wrapped.STATUS


class QpalmWorkspace(NativeWorkspace):
    """QPALM on rows [A; I]; without a start given for it, a solve begins at zero."""

    def _convert(self) -> None:
        n, m = self._n, self._m
        self._data = self._library.Data(n, m + n)
        self._data.Q = scipy.sparse.csc_matrix(self._P)
        self._data.A = scipy.sparse.csc_matrix(stacked(self._A, n))
        self._low, self._high = self._limits_of_all()

    def _build(self) -> None:
        n, m, data = self._n, self._m, self._data
        self._low[:m], self._high[:m] = self._l, self._u
        data.q, data.bmin, data.bmax = self._q, self._low, self._high
        settings = wrapped.settings_object()
        settings.verbose = False
        self._configure(settings)
        self._solver = self._library.Solver(data, settings)
        self._start = Start(n, m, self._block)

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        m, solver = self._m, self._solver
        self._low[:m], self._high[:m] = low, high
        solver.update_q(q)
        solver.update_bounds(self._low, self._high)
        if self._warm and self._start.advance():
            solver.warm_start(self._start.z, self._start.dual)

    def _call(self) -> None:
        self._solver.solve(asynchronous=False)

    def _answer(self) -> Solution:
        info, m = self._solver.info, self._m
        name = str(info.status)
        status = STATUS.get(name, Status.UNKNOWN)
        iterations, reported_ns = int(info.iter), round(info.solve_time * 1e9)
        if not status.usable:
            return self._missing(status, name, iterations, reported_ns)
        # Both are views of the library's memory.
        solution = self._solver.solution
        z, y = solution.x.copy(), solution.y.copy()
        return Solution(status, z, y[:m], y[m:], iterations, reported_ns, name)

    def _remember(self, solution: Solution) -> None:
        self._start.remember(solution)


ADAPTER = wrapped.ADAPTER.natively(NATIVE, QpalmWorkspace)
