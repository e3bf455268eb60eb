"""OSQP through its extension module: vectors updated, start given or cold, data copied by it."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import scipy.sparse

from dpbench.arrays import Vector
from dpbench.errors import DpbenchError
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Options, Policy
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Start, stacked
from dpbench.solvers.record import RouteRecord, SolverRecord
from dpbench.solvers.through_qpsolvers import osqp as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse", "warm"),
    updates="vectors",
    keeps="the step size ρ it has adapted, and the scale of the cost it took from q at its set-up",
    start="primal and dual",
    two_sided=True,
)

STATUS = wrapped.STATUS
INFINITY = 1e30  # OSQP_INFTY


class OsqpWorkspace(NativeWorkspace):
    """OSQP on rows [A; I]; `reuse` keeps the factorisation and ρ, and starts at zero."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._library = import_module("osqp.ext_builtin")

    def _convert(self) -> None:
        csc, n, m = self._library.CSC, self._n, self._m
        self._P_upper = csc(scipy.sparse.triu(self._P, format="csc"))
        self._rows = csc(scipy.sparse.csc_matrix(stacked(self._A, n)))
        self._low, self._high = np.empty(m + n), np.empty(m + n)
        np.maximum(self._lb, -INFINITY, out=self._low[m:])
        np.minimum(self._ub, INFINITY, out=self._high[m:])
        self._low_rows, self._high_rows = self._low[:m], self._high[:m]

    def _fill(self, low: Vector, high: Vector) -> None:
        np.maximum(low, -INFINITY, out=self._low_rows)
        np.minimum(high, INFINITY, out=self._high_rows)

    def _build(self) -> None:
        settings = wrapped.settings_object()
        settings.verbose, settings.warm_starting = False, self._warm
        self._configure(settings)
        self._fill(self._l, self._u)
        n, m = self._n, self._m
        self._solver = self._library.OSQPSolver(
            self._P_upper, self._q, self._rows, self._low, self._high, m + n, n, settings
        )
        self._start = Start(n, m, self._block)

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        self._fill(low, high)
        if self._solver.update_data_vec(q=q, l=self._low, u=self._high):
            raise DpbenchError("OSQP refuses the vectors: a lower limit lies above the upper one")
        if self._warm and self._start.advance():
            self._solver.warm_start(self._start.z, self._start.dual)

    def _call(self) -> None:
        self._solver.solve()

    def _answer(self) -> Solution:
        info, m = self._solver.info, self._m
        status = STATUS.get(int(info.status_val), Status.UNKNOWN)
        reported_ns, detail = round(info.solve_time * 1e9), str(info.status)
        if not status.usable:
            return self._missing(status, detail, info.iter, reported_ns)
        solution = self._solver.solution
        z, y = solution.x, solution.y  # copies, made by the library's interface
        return Solution(status, z, y[:m], y[m:], info.iter, reported_ns, detail)

    def _remember(self, solution: Solution) -> None:
        self._start.remember(solution)


ADAPTER = wrapped.ADAPTER.natively(NATIVE, OsqpWorkspace)
