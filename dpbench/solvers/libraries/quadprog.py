"""quadprog: one-sided, the inverse factor of P made once."""

from importlib import import_module
from typing import Any

import numpy as np

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import (
    NAN_FAULTS,
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    make_project_facts,
)
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace, Point

RECORD = SolverRecord(
    name="quadprog",
    family="active set",
    method="dual active set (Goldfarb-Idnani)",
    distribution="quadprog",
    module="quadprog",
    extra="core",
    form="dense",
    routes={
        "qpsolvers": RouteRecord(("fresh",), faults=NAN_FAULTS),
        "native": RouteRecord(
            ("fresh", "reuse"),
            refused={"warm": "it starts from the unconstrained optimum"},
            faults=NAN_FAULTS,
        ),
    },
    levels={},
    project=make_project_facts(
        licence=("GPL-2.0-or-later", "quadprog, metadata of its distribution"),
        language=("C, from Fortran", "quadprog, its source"),
    ),
    needs_strict_convexity=True,
)


def read_quadprog_claim_from_qpsolvers(answer: Any, options: Options) -> ClaimedStatus:
    """Return quadprog's iterations in a qpsolvers solution, which only solved ones have."""
    return ClaimedStatus(Status.SOLVED, int(answer.extras["iterations"][0]))


# The library raises ValueError for arrays of the wrong kind, which cannot happen here, for a P that
# is not positive definite, which qpsolvers reports, and for inconsistent constraints: "not found".
THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "rows",
    read_quadprog_claim_from_qpsolvers,
    lambda: (),
    not_found=ClaimedStatus(Status.PRIMAL_INFEASIBLE, detail="constraints are inconsistent"),
)


# By the text of the ValueError.
STATUS = {
    "constraints are inconsistent, no solution": Status.PRIMAL_INFEASIBLE,
    "matrix G is not positive definite": Status.NUMERICAL_ERROR,
}


class QuadprogWorkspace(OneSidedWorkspace):
    """quadprog as QP solver, on Cᵀ z ≥ b; `reuse` keeps the inverse Cholesky factor of P."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._solve_qp = self._library.solve_qp
        self._linalg = import_module("scipy.linalg")
        self._status, self._words = Status.UNKNOWN, ""

    def _prepare_one_sided_matrices(self) -> None:
        """Store equality and inequality rows, stacked and signed as quadprog takes them."""
        rows, equalities, _ = self._stack_equality_and_inequality_rows()
        rows[equalities:] *= -1.0
        self._C = np.asfortranarray(rows.T) if rows.size else None
        self._b = np.empty(rows.shape[0]) if rows.size else None
        self._equalities, self._a = equalities, np.empty(self._n)

    def _create_one_sided_library_solver(self) -> None:
        """Store the inverse Cholesky factor of P, unless every solve is to start from nothing."""
        self._factorized = self.policy != "fresh"
        self._matrix = self._P
        if self._factorized:
            upper = self._linalg.cholesky(self._P, lower=False)
            inverse = self._linalg.solve_triangular(upper, np.eye(self._n), lower=False)
            self._matrix = np.asfortranarray(inverse)
        self._send_one_sided_vectors_to_library()

    def _send_one_sided_vectors_to_library(self) -> None:
        """Write the linear cost and right-hand sides with quadprog's signs."""
        form, count = self._form, self._equalities
        np.negative(form.q, out=self._a)
        if self._b is not None:
            self._b[:count] = form.bh[:count]
            np.negative(form.bh[count:], out=self._b[count:])

    def _call_library_solve(self) -> None:
        """Call quadprog and store its result; a ValueError of it becomes a status."""
        self._result = None
        try:
            self._result = self._solve_qp(
                self._matrix, self._a, self._C, self._b, self._equalities, self._factorized
            )
        except ValueError as error:
            self._words = str(error)
            self._status = STATUS.get(self._words, Status.UNKNOWN)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return quadprog's status and iterations; it reports no time."""
        if self._result is None:
            return self._status, -1, -1, self._words
        return Status.SOLVED, int(self._result[3][0]), -1, ""

    def _copy_solution_and_multipliers(self) -> Point | None:
        """Return solution z and multipliers y, y_box of quadprog's result; None after an error."""
        if self._result is None:
            return None
        z, _, _, _, dual, _ = self._result
        count = self._equalities
        return z.copy(), *self._form.convert_multipliers_to_two_sided(dual[count:], -dual[:count])


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(QuadprogWorkspace)
