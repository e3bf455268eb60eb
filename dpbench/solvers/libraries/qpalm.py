"""QPALM: two-sided, vectors updated, start given or cold; time in seconds."""

from importlib import import_module
from typing import Any

import scipy

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import (
    Claim,
    QpsolversAdapter,
    info_reader,
    status_reader,
)
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Point, stacked
from dpbench.solvers.record import CSettings, RouteRecord, SolverRecord, by_tolerance, project_facts

RECORD = SolverRecord(
    name="qpalm",
    family="augmented Lagrangian",
    method="proximal augmented Lagrangian with an exact line search",
    distribution="qpalm",
    module="qpalm",
    extra="solvers",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(
            ("fresh",),
            refused={
                "warm": "qpsolvers sets the start as a setting `x`, which QPALM does not have, and "
                "drops the error"
            },
        ),
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            start="primal and dual",
            two_sided=True,
            faults={
                "solved despite limits that cross": "its update does not look for them, its setup "
                "does"
            },
        ),
    },
    levels=by_tolerance("eps_abs", eps_rel=0.0, max_iter=100_000),
    project=project_facts(
        licence=("LGPL-3.0-or-later", "QPALM, metadata of its distribution"),
        language=("C", "QPALM README, Supported platforms"),
        c_settings=CSettings(
            "QPALMSettings", "qpalm_set_default_settings", "QPALM source, types.h"
        ),
    ),
    time_limit="time_limit",
)

STATUS = {
    "solved": Status.SOLVED,
    "dual terminated": Status.INACCURATE,
    "maximum iterations reached": Status.MAX_ITERATIONS,
    "primal infeasible": Status.PRIMAL_INFEASIBLE,
    "dual infeasible": Status.DUAL_INFEASIBLE,
    "time limit exceeded": Status.TIME_LIMIT,
    "user cancellation": Status.ERROR,
    "error": Status.ERROR,
}
read_info = info_reader(STATUS, 1e9)


def make_settings() -> Any:
    """Return the library's settings at their defaults."""
    return import_module("qpalm").Settings()


THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD, "rows", status_reader(read_info), make_settings=make_settings
)


class QpalmWorkspace(NativeWorkspace):
    """QPALM on rows [A; I]; without a start given for it, a solve begins at zero."""

    def _convert(self) -> None:
        n, m = self._n, self._m
        self._data = self._library.Data(n, m + n)
        self._data.Q = scipy.sparse.csc_matrix(self._P)
        self._data.A = scipy.sparse.csc_matrix(stacked(self._A, n))
        self._low, self._high = self._limits_of_all()

    def _build(self) -> None:
        m, data = self._m, self._data
        self._low[:m], self._high[:m] = self._l, self._u
        data.q, data.bmin, data.bmax = self._q, self._low, self._high
        settings = make_settings()
        settings.verbose = False
        self._configure(settings)
        self._solver = self._library.Solver(data, settings)

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        m, solver = self._m, self._solver
        self._low[:m], self._high[:m] = low, high
        solver.update_q(q)
        solver.update_bounds(self._low, self._high)
        if self._has_start():
            solver.warm_start(self._start.z, self._start.dual)

    def _call(self) -> None:
        self._solver.solve(asynchronous=False)

    def _read_claim(self) -> Claim:
        info = self._solver.info
        return read_info(info, info.solve_time, self._options)

    def _read_point(self) -> Point:
        # Both are views of the library's memory.
        solution, m = self._solver.solution, self._m
        z, y = solution.x.copy(), solution.y.copy()
        return z, y[:m], y[m:]


NATIVE = THROUGH_QPSOLVERS.make_native(QpalmWorkspace)
