"""The paper's own method (eq. 30-32) as a solver: the active set by its multipliers, in NumPy.

The paper's E, F, M, γ are P, q, the signed rows of [A; I] and their limits. `dual_active_set.py`
finds the set; this module prepares the constants, refines the answer on that set and reports.

    refinement:  P δz + M_Wᵀ δλ = −(P z + q + Mᵀλ),   M_W δz = g − M_W z
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from dpbench.errors import DpbenchError
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh, Vector
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Policy, Route, Workspace
from dpbench.solvers.dual_active_set import DualActiveSet, Ending, Outcome
from dpbench.solvers.shapes import check_step, owned

STATUS = {
    Ending.OPTIMAL: Status.SOLVED,
    Ending.INFEASIBLE: Status.PRIMAL_INFEASIBLE,
    Ending.ITERATION_LIMIT: Status.MAX_ITERATIONS,
}
# A guard against rounding only: the method ends by itself, usually within n + m iterations.
ITERATIONS_PER_ROW = 100


class PaperActiveSet(Workspace):
    """The paper's method with its constant matrices kept from step to step."""

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self._base: QuadraticProgram | None = None
        self._solution: Solution | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """L, J and M of `qp`; a P that is not positive definite shows as ERROR when solved."""
        self._prepare(owned(qp))

    def _prepare(self, qp: QuadraticProgram) -> None:
        self._base, self._solution = qp, None
        n, m = qp.n, qp.m
        self._P, self._M = qp.P, np.vstack([qp.A, np.eye(n)])
        self._q = np.empty(n)
        self._lower, self._upper = np.empty(m + n), np.empty(m + n)
        self._lower[m:], self._upper[m:] = qp.lb, qp.ub
        self._refusal = ""
        try:
            self._L = np.linalg.cholesky(qp.P)
        except np.linalg.LinAlgError:
            self._refusal = "P is not positive definite"
            return self._fill(qp.q, qp.l, qp.u)
        if not (np.isfinite(self._L).all() and np.isfinite(qp.A).all()):
            self._refusal = "P or A is not finite"
            return self._fill(qp.q, qp.l, qp.u)
        J = scipy.linalg.solve_triangular(self._L, self._M.T, lower=True)
        length = np.linalg.norm(J, axis=0)
        # Rows of unit length in the norm of P⁻¹ make the method independent of units.
        self._scale = np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 1.0)
        self._J = J * self._scale
        return self._fill(qp.q, qp.l, qp.u)

    def _fill(self, q: Vector, low: Vector, high: Vector) -> None:
        self._q[:] = q
        m = low.size
        self._lower[:m], self._upper[:m] = low, high
        self._solution = None

    def update(self, step: QPStep) -> None:
        """Take over the vectors; new matrices are factorised again."""
        base = self._base
        if base is None:
            raise DpbenchError("update before setup: call setup with the whole problem first")
        check_step(step, base.n, base.m)
        if step.refresh is Refresh.VECTORS:
            self._fill(step.q, step.l, step.u)
        else:
            self._prepare(owned(base.at(step)))

    def solve(self) -> None:
        """Find the active set and the answer on it."""
        if self._base is None:
            raise DpbenchError("solve before setup: call setup with the whole problem first")
        try:
            self._solution = self._answer(self._base.n, self._base.m)
        except np.linalg.LinAlgError as error:
            self._solution = self._missing(Status.NUMERICAL_ERROR, str(error))

    def _missing(self, status: Status, detail: str) -> Solution:
        n = self._q.size
        return Solution.missing(n, self._upper.size - n, status, detail)

    def _answer(self, n: int, m: int) -> Solution:
        lower, upper = self._lower, self._upper
        if self._refusal:
            return self._missing(Status.ERROR, self._refusal)
        if not np.isfinite(self._q).all() or np.isnan(lower).any() or np.isnan(upper).any():
            return self._missing(Status.ERROR, "q is not finite, or a limit is NaN")
        crossed = np.flatnonzero((lower > upper) | (lower == np.inf) | (upper == -np.inf))
        if crossed.size:
            detail = f"the limits of row {crossed[0]} of [A; I] cross"
            return self._missing(Status.PRIMAL_INFEASIBLE, detail)
        x0 = -np.linalg.solve(self._L, self._q)
        method = DualActiveSet(
            self._J, x0, lower * self._scale, upper * self._scale, ITERATIONS_PER_ROW * (n + m)
        )
        outcome = method.run()
        lam = outcome.multipliers * self._scale
        if outcome.ending is Ending.INFEASIBLE:
            z, detail = np.full(n, np.nan), "y and y_box are a Farkas ray"
        else:
            z, lam = self._refined(outcome, lam)
            detail = "" if outcome.ending is Ending.OPTIMAL else outcome.ending.value
        status = STATUS[outcome.ending]
        return Solution(status, z, lam[:m], lam[m:], outcome.iterations, detail=detail)

    def _refined(self, outcome: Outcome, lam: Vector) -> tuple[Vector, Vector]:
        """The answer on the final set, less rows whose multiplier is rounding of the wrong sign."""
        W, side = outcome.active, outcome.side
        inequality = self._lower < self._upper
        z = -np.linalg.solve(self._L.T, np.linalg.solve(self._L, self._q + self._M.T @ lam))
        while True:
            z, lam = self._on_set(W, side, z, lam)
            wrong = inequality[W] & (side[W] * lam[W] < 0.0)
            if not wrong.any():
                return z, lam
            lam[W[wrong]] = 0.0
            W = W[~wrong]

    def _on_set(
        self, W: NDArray[np.intp], side: Vector, z: Vector, lam: Vector
    ) -> tuple[Vector, Vector]:
        """Two rounds of iterative refinement of (z, λ) on W, in the problem's own data."""
        L, M = self._L, self._M
        J_W = self._J[:, W] / self._scale[W]
        Q, R = np.linalg.qr(J_W)
        g = np.where(side[W] > 0.0, self._upper[W], self._lower[W])
        for _ in range(2):
            e = -np.linalg.solve(L, self._P @ z + self._q + M.T @ lam)
            step = np.linalg.solve(R, Q.T @ e - np.linalg.solve(R.T, g - M[W] @ z))
            lam[W] += step
            z = z + np.linalg.solve(L.T, e - J_W @ step)
        return z, lam

    def read(self) -> Solution:
        """The answer; every call gives it in new memory."""
        found = self._solution
        if found is None:
            return self._missing(Status.ERROR, "read before solve")
        y, y_box = found.y.copy(), found.y_box.copy()
        return Solution(
            found.status, found.z.copy(), y, y_box, found.iterations, detail=found.detail
        )


class FreshPaperActiveSet(PaperActiveSet):
    """The same, set up from nothing at each step."""

    setup_every_step = True
