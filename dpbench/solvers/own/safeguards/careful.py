"""The active-set method on an orthogonal factorisation, for what rounding keeps the fast one from.

`qp/dual_active_set.py` finds the set without ever forming products of rows, so that rows at an
angle of 1e-10 are still told apart; this module refines the answer on the set and reports.

    refinement:  P δz + M_Wᵀ δλ = −(P z + q + Mᵀλ),   M_W δz = g − M_W z
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.qp.dual_active_set import CONTRADICTION, Ending, Outcome, Projection
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Solution, Status

STATUS = {
    Ending.OPTIMAL: Status.SOLVED,
    Ending.INFEASIBLE: Status.PRIMAL_INFEASIBLE,
    Ending.ITERATION_LIMIT: Status.MAX_ITERATIONS,
}
# Of refinement; each gains the digits that the conditioning of the set has left.
ROUNDS = 5


def solve_carefully(
    qp: QuadraticProgram, *, start: Vector | None = None, contradiction: float = CONTRADICTION
) -> Solution:
    """Solve `qp`, whose P is positive definite and whose data are finite or limits.

    Parameters
    ----------
    start : (m + n,) signs of the rows of [A; I] to begin with, independent of one another.
    contradiction : share by which a row must contradict others for the answer to be infeasible;
        with inf it is a point, whatever it violates.
    """
    try:
        M = np.vstack([qp.A, np.eye(qp.n)])
        problem = _Problem(qp, M, *qp.limits(), Projection.of(qp.P, M))
        return problem.answer(start, contradiction)
    except np.linalg.LinAlgError as error:
        return Solution.missing(qp.n, qp.m, Status.NUMERICAL_ERROR, str(error))


@dataclass(eq=False)
class _Problem:
    """The problem with its rows M = [A; I] and their limits, and as a projection."""

    qp: QuadraticProgram
    M: Matrix
    lower: Vector
    upper: Vector
    projection: Projection

    def answer(self, start: Vector | None, contradiction: float) -> Solution:
        """Run the method, refine where it ended, and say how it ended."""
        n, m = self.qp.n, self.qp.m
        outcome = self.projection.solve(
            self.qp.q, self.lower, self.upper, start=start, contradiction=contradiction
        )
        lam = outcome.multipliers
        if outcome.ending is Ending.INFEASIBLE:
            z, detail = np.full(n, np.nan), "y and y_box are a Farkas ray"
        else:
            z, lam = self._refined(outcome, lam)
            detail = "" if outcome.ending is Ending.OPTIMAL else outcome.ending.value
        status = STATUS[outcome.ending]
        return Solution(status, z, lam[:m], lam[m:], outcome.iterations, detail=detail)

    def _refined(self, outcome: Outcome, lam: Vector) -> tuple[Vector, Vector]:
        """Refine on the final set, less rows whose multiplier is rounding of the wrong sign."""
        W, side = outcome.active, outcome.side
        inequality = self.lower < self.upper
        L = self.projection.L
        z = -np.linalg.solve(L.T, np.linalg.solve(L, self.qp.q + self.M.T @ lam))
        while True:
            z, lam = self._on_set(W, side, z, lam)
            wrong = inequality[W] & (side[W] * lam[W] < 0.0)
            if not wrong.any():
                return z, lam
            lam[W[wrong]] = 0.0
            W = W[~wrong]

    def _on_set(self, W: Indices, side: Vector, z: Vector, lam: Vector) -> tuple[Vector, Vector]:
        """Refinement of (z, λ) on W in the problem's own data, residuals in long double."""
        L, M, qp = self.projection.L, self.M.astype(np.longdouble), self.qp
        P, q = qp.P.astype(np.longdouble), qp.q.astype(np.longdouble)
        J_W = self.projection.J[:, W] / self.projection.scale[W]
        Q, R = np.linalg.qr(J_W)
        g = np.where(side[W] > 0.0, self.upper[W], self.lower[W])
        for _ in range(ROUNDS):
            e = -np.linalg.solve(L, (P @ z + q + lam @ M).astype(np.float64))
            slack = (g - M[W] @ z).astype(np.float64)
            step = np.linalg.solve(R, Q.T @ e - np.linalg.solve(R.T, slack))
            lam[W] += step
            z = z + np.linalg.solve(L.T, e - J_W @ step)
        return z, lam
