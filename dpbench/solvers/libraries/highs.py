"""HiGHS through its own interface: two-sided, vectors changed in its model, no start."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse

from dpbench.arrays import Vector
from dpbench.errors import DpbenchError
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.libraries.native_workspace import NativeWorkspace
from dpbench.solvers.record import RouteRecord
from dpbench.solvers.through_qpsolvers import highs as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse"),
    updates="vectors",
    two_sided=True,
    refused={
        "warm": "its QP solver takes no start: with the basis kept or cleared the answers and "
        "iterations are the same to the last bit"
    },
)

STATUS = {
    "kOptimal": Status.SOLVED,
    "kModelEmpty": Status.SOLVED,
    "kInfeasible": Status.PRIMAL_INFEASIBLE,
    "kUnbounded": Status.DUAL_INFEASIBLE,
    "kUnboundedOrInfeasible": Status.PRIMAL_INFEASIBLE,
    "kIterationLimit": Status.MAX_ITERATIONS,
    "kTimeLimit": Status.TIME_LIMIT,
    "kLoadError": Status.ERROR,
    "kModelError": Status.ERROR,
    "kPresolveError": Status.ERROR,
    "kSolveError": Status.NUMERICAL_ERROR,
    "kPostsolveError": Status.ERROR,
    "kMemoryLimit": Status.ERROR,
    "kInterrupt": Status.ERROR,
    "kHighsInterrupt": Status.ERROR,
    "kUnknown": Status.UNKNOWN,
    "kNotset": Status.UNKNOWN,
}


class HighsWorkspace(NativeWorkspace):
    """HiGHS with rows and bounds as they are."""

    def _convert(self) -> None:
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

    def _build(self) -> None:
        lp = self._model.lp_
        lp.col_cost_, lp.row_lower_, lp.row_upper_ = self._q, self._l, self._u
        solver = self._library.Highs()
        solver.setOptionValue("output_flag", False)
        for name, value in self._options.items():
            solver.setOptionValue(name, value)
        self._solver = solver
        self._check(solver.passModel(self._model))

    def _check(self, outcome: Any) -> None:
        if outcome == self._library.HighsStatus.kError:
            raise DpbenchError("HiGHS refuses the model")

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        solver = self._solver
        self._check(solver.changeColsCost(self._n, self._columns, q))
        if self._m:
            self._check(solver.changeRowsBounds(self._m, self._row_numbers, low, high))

    def _call(self) -> None:
        self._solver.run()

    def _answer(self) -> Solution:
        solver = self._solver
        name = str(solver.getModelStatus().name)
        status = STATUS.get(name, Status.UNKNOWN)
        iterations = int(solver.getInfo().qp_iteration_count)
        solution = solver.getSolution()
        if not (status.usable and solution.value_valid):
            return self._missing(status, name, iterations)
        z = np.array(solution.col_value)
        if solution.dual_valid:
            # Its multipliers are positive at a lower limit.
            y, y_box = -np.array(solution.row_dual), -np.array(solution.col_dual)
        else:
            y, y_box = np.full(self._m, np.nan), np.full(self._n, np.nan)
        return Solution(status, z, y, y_box, iterations, detail=name)


ADAPTER = wrapped.ADAPTER.natively(NATIVE, HighsWorkspace)
