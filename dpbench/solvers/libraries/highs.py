"""HiGHS: two-sided, vectors changed in its model, no start."""

from importlib import import_module
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Vector
from dpbench.errors import DpbenchError
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, QpsolversAdapter, read_solved_flag_as_claim
from dpbench.solvers.contract import (
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Point

TIME_LIMIT = "time_limit"

RECORD = SolverRecord(
    name="highs",
    family="active set",
    method="primal null-space active set",
    distribution="highspy",
    module="highspy",
    extra="solvers",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(
            ("fresh",),
            detects_infeasibility=False,
            faults={"solved despite a nan in u": "before 1.16 a NaN limit limits nothing"},
        ),
        "native": RouteRecord(
            ("fresh", "reuse"),
            updates="vectors",
            two_sided=True,
            refused={
                "warm": "its QP solver accepts no starting point: with the basis kept or cleared "
                "the answers and iterations are the same to the last bit"
            },
        ),
    },
    levels=make_tolerance_presets(
        "primal_feasibility_tolerance", "dual_feasibility_tolerance", qp_regularization_value=0.0
    ),
    project=make_project_facts(
        licence=("MIT", "HiGHS, metadata of its distribution"),
        language=("C++, C interface", "HiGHS documentation, front page"),
    ),
    iteration_limit="qp_iteration_limit",
    time_limit=TIME_LIMIT,
)


# Without a solution HiGHS fills x with zeros, which must not be taken for an iterate.
THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "native",
    read_solved_flag_as_claim,
    make_settings=lambda: import_module("highspy").HighsOptions(),
    iterate_when_not_found=False,
)


STATUS = {
    "kOptimal": Status.SOLVED,
    "kModelEmpty": Status.SOLVED,
    "kInfeasible": Status.PRIMAL_INFEASIBLE,
    "kUnbounded": Status.DUAL_INFEASIBLE,
    "kUnboundedOrInfeasible": Status.PRIMAL_INFEASIBLE,
    "kIterationLimit": Status.MAX_ITERATIONS,
    "kTimeLimit": Status.TIME_LIMIT,
    "kSolveError": Status.NUMERICAL_ERROR,
}
_ERRORS = "LoadError ModelError PresolveError PostsolveError MemoryLimit Interrupt HighsInterrupt"
STATUS |= {f"k{name}": Status.ERROR for name in _ERRORS.split()}


class HighsWorkspace(NativeWorkspace):
    """HiGHS as QP solver, with two-sided rows, bounds and a sparse Hessian."""

    def _prepare_matrices_for_library(self) -> None:
        """Store a HiGHS model with Hessian, rows and bounds."""
        n, m, library = self._n, self._m, self._library
        lower, rows = scipy.sparse.tril(self._P, format="csc"), scipy.sparse.csc_matrix(self._A)
        model = library.HighsModel()
        hessian, lp = model.hessian_, model.lp_
        hessian.dim_ = n
        hessian.start_, hessian.index_, hessian.value_ = lower.indptr, lower.indices, lower.data
        lp.num_col_, lp.num_row_ = n, m
        lp.col_lower_, lp.col_upper_ = self._lb, self._ub
        matrix = lp.a_matrix_
        matrix.format_ = library.MatrixFormat.kColwise
        matrix.num_row_, matrix.num_col_ = m, n
        matrix.start_, matrix.index_, matrix.value_ = rows.indptr, rows.indices, rows.data
        self._model = model
        self._columns, self._row_numbers = (np.arange(k, dtype=np.int32) for k in (n, m))

    def _create_library_solver(self) -> None:
        """Store a new HiGHS solver with the model and all options."""
        lp = self._model.lp_
        lp.col_cost_, lp.row_lower_, lp.row_upper_ = self._q, self._l, self._u
        solver = self._library.Highs()
        solver.setOptionValue("output_flag", False)
        for name, value in self._options.items():
            solver.setOptionValue(name, value)
        self._solver = solver
        self._raise_on_highs_error(solver.passModel(self._model))

    def _raise_on_highs_error(self, outcome: Any) -> None:
        """Raise DpbenchError if a HiGHS call returned an error."""
        if outcome == self._library.HighsStatus.kError:
            raise DpbenchError("HiGHS refuses the model")

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's costs and row limits to HiGHS."""
        solver = self._solver
        self._raise_on_highs_error(solver.changeColsCost(self._n, self._columns, q))
        if self._m:
            self._raise_on_highs_error(
                solver.changeRowsBounds(self._m, self._row_numbers, low, high)
            )

    def _call_library_solve(self) -> None:
        """Run HiGHS in place; its time limit is raised by the run time of earlier solves."""
        if TIME_LIMIT in self._options:
            # HiGHS compares the limit with the run time of all solves of the object so far.
            limit_s = float(str(self._options[TIME_LIMIT]))
            self._solver.setOptionValue(TIME_LIMIT, self._solver.getRunTime() + limit_s)
        self._solver.run()

    def _read_status_iterations_and_time(self) -> Claim:
        """Return the model status and iterations of HiGHS, which reports no time."""
        name = str(self._solver.getModelStatus().name)
        iterations = int(self._solver.getInfo().qp_iteration_count)
        return STATUS.get(name, Status.UNKNOWN), iterations, -1, name

    def _copy_solution_and_multipliers(self) -> Point | None:
        """Return HiGHS's solution z and multipliers, with their signs turned; None if none."""
        solution = self._solver.getSolution()
        if not solution.value_valid:
            return None
        if solution.dual_valid:
            # Its multipliers are positive at a lower limit.
            y, y_box = -np.array(solution.row_dual), -np.array(solution.col_dual)
        else:
            y, y_box = np.full(self._m, np.nan), np.full(self._n, np.nan)
        return np.array(solution.col_value), y, y_box


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(HighsWorkspace)
