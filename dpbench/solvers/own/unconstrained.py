"""The baseline law: the unconstrained optimum.

    z = −P⁻¹ q                                                                        (eq. 27)

The closed loop clips it to the actuator limits, which is what a controller without a QP does.
"""

import numpy as np
import scipy.linalg

from dpbench.arrays import Vector
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import (
    Policy,
    Route,
    Workspace,
    check_step,
    make_error_for_missing_setup,
)


class UnconstrainedWorkspace(Workspace):
    """The unconstrained optimum z = −P⁻¹q as a solver; P's Cholesky factor is kept over steps."""

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self.setup_every_step = policy == "fresh"
        self._base: QuadraticProgram | None = None
        self._factor: np.ndarray | None = None
        self._z: Vector | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Store the factors of P; a P that is not positive definite shows as ERROR when solved."""
        self._base, self._z = qp.copy(), None
        self._q = self._base.q.copy()
        try:
            self._factor = np.linalg.cholesky(self._base.P)
        except np.linalg.LinAlgError:
            self._factor = None

    def update(self, step: QPStep) -> None:
        """Store the linear cost q; factorise P again if matrices changed."""
        if self._base is None:
            raise make_error_for_missing_setup("update")
        check_step(step, self._base.n, self._base.m)
        if step.refresh is Refresh.VECTORS:
            self._q[:] = step.q
            self._z = None
        else:
            self.matrix_updates += 1
            self.setup(self._base.at(step))

    def solve(self) -> None:
        """Store the unconstrained optimum z = −P⁻¹q, by two triangular solves."""
        if self._factor is not None:
            self._z = scipy.linalg.cho_solve((self._factor, True), -self._q, check_finite=False)

    def read(self) -> Solution:
        """Return the unconstrained optimum with zero multipliers and status UNKNOWN."""
        if self._base is None:
            raise make_error_for_missing_setup("read")
        n, m = self._base.n, self._base.m
        if self._factor is None:
            return Solution.without_point(n, m, Status.ERROR, "P is not positive definite")
        if self._z is None:
            return Solution.without_point(n, m, Status.ERROR, "read before solve")
        return Solution(Status.UNKNOWN, self._z.copy(), np.zeros(m), np.zeros(n), iterations=0)
