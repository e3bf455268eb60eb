"""quadprog through its own interface: one-sided, the inverse factor of P made once."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Options, Policy
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace
from dpbench.solvers.record import NAN_FAULTS, RouteRecord, SolverRecord
from dpbench.solvers.through_qpsolvers import quadprog as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse"),
    refused={"warm": "it starts from the unconstrained optimum"},
    faults=NAN_FAULTS,
)

# It raises what it has to say.
STATUS = {
    "constraints are inconsistent, no solution": Status.PRIMAL_INFEASIBLE,
    "matrix G is not positive definite": Status.NUMERICAL_ERROR,
}


class QuadprogWorkspace(OneSidedWorkspace):
    """quadprog on Cᵀ z ≥ b; it has no state, so `reuse` means P = RᵀR comes as R⁻¹."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._solve_qp = self._library.solve_qp
        self._result: Any = None
        self._status, self._words = Status.UNKNOWN, ""

    def _arrange(self) -> None:
        rows, equalities, _ = self._rows()
        rows[equalities:] *= -1.0
        self._C = np.asfortranarray(rows.T) if rows.size else None
        self._b = np.empty(rows.shape[0]) if rows.size else None
        self._equalities, self._a = equalities, np.empty(self._n)

    def _create(self) -> None:
        self._factorized = self.policy != "fresh"
        self._matrix = self._P
        if self._factorized:
            upper = scipy.linalg.cholesky(self._P, lower=False)
            inverse = scipy.linalg.solve_triangular(upper, np.eye(self._n), lower=False)
            self._matrix = np.asfortranarray(inverse)
        self._send()

    def _send(self) -> None:
        form, count = self._form, self._equalities
        np.negative(form.q, out=self._a)
        if self._b is not None:
            self._b[:count] = form.bh[:count]
            np.negative(form.bh[count:], out=self._b[count:])

    def _call(self) -> None:
        self._result = None
        try:
            self._result = self._solve_qp(
                self._matrix, self._a, self._C, self._b, self._equalities, self._factorized
            )
        except ValueError as error:
            self._words = str(error)
            self._status = STATUS.get(self._words, Status.UNKNOWN)

    def _answer(self) -> Solution:
        if self._result is None:
            return self._missing(self._status, self._words)
        z, _, _, iterations, dual, _ = self._result
        count = self._equalities
        y, y_box = self._form.two_sided(dual[count:], -dual[:count])
        return Solution(Status.SOLVED, z.copy(), y, y_box, int(iterations[0]))


ADAPTER = wrapped.ADAPTER.natively(NATIVE, QuadprogWorkspace)
