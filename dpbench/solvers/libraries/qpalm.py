"""QPALM: two-sided, vectors updated, start given or cold; time in seconds."""

from importlib import import_module

import scipy

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import (
    Claim,
    QpsolversAdapter,
    make_reader_of_library_info,
    make_reader_of_qpsolvers_status,
)
from dpbench.solvers.contract import (
    CSettings,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import (
    NativeWorkspace,
    Point,
    append_identity_rows_for_bounds,
)

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
                "warm": "qpsolvers sets the starting point as a setting `x`, which QPALM does not "
                "have, and drops the error"
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
    levels=make_tolerance_presets("eps_abs", eps_rel=0.0, max_iter=100_000),
    project=make_project_facts(
        licence=("LGPL-3.0-or-later", "QPALM, metadata of its distribution"),
        language=("C", "QPALM README, Supported platforms"),
        c_settings=CSettings(
            "QPALMSettings", "qpalm_set_default_settings", "QPALM source, types.h"
        ),
    ),
    iteration_limit="max_iter",
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
read_info = make_reader_of_library_info(STATUS, 1e9)


THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "rows",
    make_reader_of_qpsolvers_status(read_info),
    make_settings=lambda: import_module("qpalm").Settings(),
)


class QpalmWorkspace(NativeWorkspace):
    """QPALM as QP solver, bounds as rows; without a warm start, a solve begins at zero."""

    def _prepare_matrices_for_library(self) -> None:
        """Store sparse P and [A; I], bounds as rows, for QPALM, and arrays of limits."""
        n, m = self._n, self._m
        self._data = self._library.Data(n, m + n)
        self._data.Q = scipy.sparse.csc_matrix(self._P)
        self._data.A = scipy.sparse.csc_matrix(append_identity_rows_for_bounds(self._A, n))
        self._low, self._high = self._allocate_limits_of_rows_and_bounds()

    def _create_library_solver(self) -> None:
        """Store a new QPALM solver made of all data and options."""
        m, data = self._m, self._data
        self._low[:m], self._high[:m] = self._l, self._u
        data.q, data.bmin, data.bmax = self._q, self._low, self._high
        settings = self._library.Settings()
        settings.verbose = False
        self._set_options_on_library_settings(settings)
        self._solver = self._library.Solver(data, settings)

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's cost, limits and shifted warm start to QPALM."""
        m, solver = self._m, self._solver
        self._low[:m], self._high[:m] = low, high
        solver.update_q(q)
        solver.update_bounds(self._low, self._high)
        if self._shift_warm_start_if_any():
            solver.warm_start(self._start.z, self._start.dual)

    def _call_library_solve(self) -> None:
        """Call QPALM's solve function in this thread."""
        self._solver.solve(asynchronous=False)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return QPALM's status, iterations and solve time."""
        info = self._solver.info
        return read_info(info, info.solve_time, self._options)

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of QPALM's solution and multipliers."""
        # Both are views of the library's memory.
        solution, m = self._solver.solution, self._m
        z, y = solution.x.copy(), solution.y.copy()
        return z, y[:m], y[m:]


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(QpalmWorkspace)
