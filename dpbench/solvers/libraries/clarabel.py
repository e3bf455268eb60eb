"""Clarabel: one-sided, vectors updated, no start; status names as in its Rust source."""

from importlib import import_module
from typing import Any

import numpy as np
import scipy

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, QpsolversAdapter
from dpbench.solvers.contract import (
    Options,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace, Point

RECORD = SolverRecord(
    name="clarabel",
    family="interior point",
    method="primal-dual interior point, homogeneous embedding",
    distribution="clarabel",
    module="clarabel",
    extra="core",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(("fresh",)),
        "native": RouteRecord(
            ("fresh", "reuse"),
            updates="vectors",
            keeps="the equilibration it took from P, A and q at its set-up",
            refused={"warm": "Clarabel has no interface for a starting point"},
        ),
    },
    levels=make_tolerance_presets("tol_gap_abs", "tol_gap_rel", "tol_feas", max_iter=500),
    project=make_project_facts(
        licence=("Apache-2.0", "Clarabel, metadata of its distribution"),
        language=("Rust", "Clarabel, metadata of its distribution"),
        single_precision=("yes, generic in its float type", "Clarabel.rs source, algebra/floats"),
    ),
    iteration_limit="max_iter",
    time_limit="time_limit",
)

# The "almost" infeasibility claims meet the reduced tolerances; they are claims all the same.
STATUS = {
    "Solved": Status.SOLVED,
    "AlmostSolved": Status.INACCURATE,
    "PrimalInfeasible": Status.PRIMAL_INFEASIBLE,
    "AlmostPrimalInfeasible": Status.PRIMAL_INFEASIBLE,
    "DualInfeasible": Status.DUAL_INFEASIBLE,
    "AlmostDualInfeasible": Status.DUAL_INFEASIBLE,
    "MaxIterations": Status.MAX_ITERATIONS,
    "MaxTime": Status.TIME_LIMIT,
    "NumericalError": Status.NUMERICAL_ERROR,
    "InsufficientProgress": Status.NUMERICAL_ERROR,
}


def convert_clarabel_result_to_claim(status: Any, iterations: int, solve_s: float) -> Claim:
    """Return Clarabel's status, iterations and time [s] as the common status and time [ns]."""
    name = str(status)
    return STATUS.get(name, Status.UNKNOWN), iterations, round(solve_s * 1e9), name


def read_clarabel_status_from_qpsolvers(answer: Any, options: Options) -> Claim:
    """Return Clarabel's status and time in a qpsolvers solution, which lacks iterations."""
    return convert_clarabel_result_to_claim(
        answer.extras["status"], -1, answer.extras["solve_time"]
    )


THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "rows",
    read_clarabel_status_from_qpsolvers,
    make_settings=lambda: import_module("clarabel").DefaultSettings(),
)


class ClarabelWorkspace(OneSidedWorkspace):
    """Clarabel as QP solver, with cones: [A; G] z + s = [b; h], s zero or nonnegative."""

    def _prepare_one_sided_matrices(self) -> None:
        """Store P, stacked rows (equalities first) as sparse matrices, and Clarabel's cones."""
        rows, equalities, inequalities = self._stack_equality_and_inequality_rows()
        self._P_upper = scipy.sparse.triu(self._P, format="csc")
        self._matrix = scipy.sparse.csc_matrix(rows)
        zero, nonnegative = self._library.ZeroConeT, self._library.NonnegativeConeT
        sizes = ((zero, equalities), (nonnegative, inequalities))
        self._cones = [cone(size) for cone, size in sizes if size]
        self._equalities = equalities

    def _create_one_sided_library_solver(self) -> None:
        """Store a new Clarabel solver for the QP, without presolve."""
        settings = self._library.DefaultSettings()
        # Presolve would drop rows, and with them the right to update.
        settings.verbose, settings.presolve_enable = False, False
        self._set_options_on_library_settings(settings)
        form = self._form
        self._solver = self._library.DefaultSolver(
            self._P_upper, form.q, self._matrix, form.bh, self._cones, settings
        )

    def _send_one_sided_vectors_to_library(self) -> None:
        """Pass the linear cost and right-hand sides to Clarabel."""
        self._solver.update(q=self._form.q, b=self._form.bh)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return Clarabel's status, iterations and solve time."""
        result = self._result
        return convert_clarabel_result_to_claim(
            result.status, int(result.iterations), result.solve_time
        )

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of Clarabel's solution and multipliers."""
        dual, count = np.array(self._result.z), self._equalities
        return np.array(self._result.x), *self._form.convert_multipliers_to_two_sided(
            dual[count:], dual[:count]
        )


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(ClarabelWorkspace)
