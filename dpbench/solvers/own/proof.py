"""Decisions that rounding makes hard: infeasibility, dependent equalities, nearly parallel rows.

A Farkas ray (y, y_box) proves that a problem has no feasible point, in exact arithmetic, if

    Aᵀy + y_box = 0,   Σ u y⁺ − Σ l y⁻ + Σ ub y_box⁺ − Σ lb y_box⁻ < 0

The referee checks this exactly. A solver's data have been rounded, so it needs tolerances for zero.

A row with equal limits that is a combination of others only up to rounding counts as independent
and fixes one point more, which rounding decides; an exact combination with another limit leaves no
point. No floating-point answer is the optimum then, whatever its residuals, so combinations
rest = r · basis are computed in long double.

The careful solver finds the active set on an orthogonal factorisation (`qp/dual_active_set.py`),
which separates rows at an angle of 1e-10, and refines the answer on it:

    P δz + M_Wᵀ δλ = −(P z + q + Mᵀλ),   M_W δz = g − M_W z
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.qp.dual_active_set import CONTRADICTION, Ending, Outcome, Projection
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Solution, Status

ROUNDING = 1e-13
"""Entries of a ray below this share of its largest are rounding."""
CONSISTENT = 1e-6
"""Share of its terms below which a sum of a ray may be meant to vanish."""
PROVEN = 1e-10
"""Share of its terms to which a sum of a proof is taken to be what it is computed to be."""
TINY = 2.3e-308
"""The smallest number that is not subnormal."""
FAR = 1e6
"""How many times farther than the limits of the proof are no feasible point is left, where a
variable has no bound to absorb what does not cancel."""


def proves_infeasible(qp: QuadraticProgram, y: Vector, y_box: Vector) -> bool:
    """Return whether a Farkas ray (y, y_box) proves a QP infeasible, up to rounding."""
    return bool(is_infeasibility_proof(qp.A, qp.l, qp.u, qp.lb, qp.ub, y, y_box))


@njit("void(f8[:], f8[:])", cache=True)
def drop_ray_rounding(y, y_box):  # type: ignore[no-untyped-def] # compiled by numba
    """Set entries of a Farkas ray to zero that are rounding, relative to its largest."""
    most = 0.0
    for part in (y, y_box):
        for i in range(len(part)):
            most = max(most, abs(part[i]))
    for part in (y, y_box):
        for i in range(len(part)):
            part[i] = part[i] if abs(part[i]) > ROUNDING * most else 0.0


@njit("UniTuple(f8, 2)(f8[:], f8[:], f8[:])", cache=True)
def _largest_sum_along_ray(ray, low, high):  # type: ignore[no-untyped-def] # compiled by numba
    """Return the largest Σ ray·value that the limits allow, and the sum of its |terms|."""
    reach, size = 0.0, 0.0
    for i in range(len(ray)):
        if ray[i] != 0.0:
            term = ray[i] * (high[i] if ray[i] > 0.0 else low[i])
            reach, size = reach + term, size + abs(term)
    return reach, size


@njit("b1(f8[:, :], f8[:], f8[:], f8[:], f8[:], f8[:], f8[:])", cache=True, error_model="numpy")
def is_infeasibility_proof(A, l, u, lb, ub, y, y_box):  # type: ignore[no-untyped-def] # noqa: E741 - compiled by numba; of l ≤ Az ≤ u
    """Return whether a Farkas ray (y, y_box) proves limits of rows and bounds contradictory.

    Aᵀy + y_box vanishes to `CONSISTENT` of the terms it is the sum of. With y_box := −Aᵀy, what the
    limits allow the sum of y(Az) + y_box z to reach is negative by more than `PROVEN` of its terms,
    and by more than what entries of y_box that name no bound can add within `FAR`.
    """
    box, terms = np.zeros(len(y_box)), np.abs(y_box)
    for i in range(len(y)):
        if y[i] != 0.0:
            for k in range(len(box)):
                box[k] -= y[i] * A[i, k]
                terms[k] += abs(y[i] * A[i, k])
    unbounded, most = 0.0, TINY
    for k in range(len(box)):
        if not abs(box[k] - y_box[k]) <= CONSISTENT * terms[k]:
            return False
        most = max(most, terms[k])
        if abs(ub[k] if box[k] > 0.0 else lb[k]) == np.inf:
            unbounded += abs(box[k])
            box[k] = 0.0
    of_rows, of_bounds = _largest_sum_along_ray(y, l, u), _largest_sum_along_ray(box, lb, ub)
    size = of_rows[1] + of_bounds[1]
    return of_rows[0] + of_bounds[0] < -(PROVEN + FAR * unbounded / most) * size


INDEPENDENT = 1e-7
"""Share of a row's length that has to be left beside the others."""
LONG_ROUNDING = float(np.finfo(np.longdouble).eps)
"""Of each term of a combination: far less than rounding to double leaves."""
LONG_ROUNDS = 4
"""Of refinement of r; each gains the digits that a condition of 1 / `INDEPENDENT` has left."""


def has_consistent_equalities(qp: QuadraticProgram) -> bool:
    """Return whether equality rows, bounds included, are independent or exactly redundant.

    Where long double is no longer than double, rows redundant to rounding count as exactly so.
    """
    low, high = qp.limits()
    rows, limits = np.vstack([qp.A, np.eye(qp.n)])[low == high], low[low == high]
    rows, limits = rows[rows.any(axis=1)], limits[rows.any(axis=1)]
    if len(rows) < 2:
        return True
    length = np.linalg.norm(rows, axis=1)
    R, order = scipy.linalg.qr(rows.T / length, mode="r", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diagonal(R)) > INDEPENDENT))
    both = np.column_stack([rows, limits])
    return _has_only_redundant_rows(both[order[:rank]], both[order[rank:]])


def has_independent_rows(rows: Matrix, share: float) -> bool:
    """Return whether each row is farther than `share` of its length from the span of others."""
    rows = rows[rows.any(axis=1)]
    if len(rows) > rows.shape[1]:
        return False
    R = scipy.linalg.qr((rows.T / np.linalg.norm(rows, axis=1)), mode="r", pivoting=True)[0]
    return bool((np.abs(np.diagonal(R)) > share).all())


def _has_only_redundant_rows(basis: Matrix, rest: Matrix) -> bool:
    """Return whether each row of `rest`, limit included, exactly combines `basis` rows."""
    Q, R = np.linalg.qr(basis[:, :-1].T)
    exact, target = basis.astype(np.longdouble), rest.astype(np.longdouble)
    r = np.zeros((len(rest), len(basis)), dtype=np.longdouble)
    for _ in range(LONG_ROUNDS):
        left = (target - r @ exact).astype(np.float64)[:, :-1]
        r += scipy.linalg.solve_triangular(R, Q.T @ left.T).T
    terms = np.abs(target).max(axis=1) + np.abs(r) @ np.abs(exact).max(axis=1)
    rounding = LONG_ROUNDING * (2 + len(basis)) * terms
    return bool((np.abs(target - r @ exact).max(axis=1) <= rounding).all())


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
    """Solve a strictly convex QP by an accurate, slower active-set method: orthogonal factors.

    Parameters
    ----------
    start : (m + n,) signs of the rows of [A; I] to begin with, independent of one another.
    contradiction : share by which a row must contradict others for the answer to be infeasible;
        with inf it is a point, whatever it violates.
    """
    try:
        M = np.vstack([qp.A, np.eye(qp.n)])
        problem = _ProjectedProblem(qp, M, *qp.limits(), Projection.of(qp.P, M))
        return problem.solve(start, contradiction)
    except np.linalg.LinAlgError as error:
        return Solution.missing(qp.n, qp.m, Status.NUMERICAL_ERROR, str(error))


@dataclass(eq=False)
class _ProjectedProblem:
    """A QP with bounds stacked as rows [A; I], and its factorisation for an active-set method."""

    qp: QuadraticProgram
    M: Matrix
    lower: Vector
    upper: Vector
    projection: Projection

    def solve(self, start: Vector | None, contradiction: float) -> Solution:
        """Solve the QP by an active-set method and refine the answer on the final active set."""
        n, m = self.qp.n, self.qp.m
        outcome = self.projection.solve(
            self.qp.q, self.lower, self.upper, start=start, contradiction=contradiction
        )
        lam = outcome.multipliers
        if outcome.ending is Ending.INFEASIBLE:
            z, detail = np.full(n, np.nan), "y and y_box are a Farkas ray"
        else:
            z, lam = self._refine_solution(outcome, lam)
            detail = "" if outcome.ending is Ending.OPTIMAL else outcome.ending.value
        status = STATUS[outcome.ending]
        return Solution(status, z, lam[:m], lam[m:], outcome.iterations, detail=detail)

    def _refine_solution(self, outcome: Outcome, lam: Vector) -> tuple[Vector, Vector]:
        """Refine z and multipliers on the final active set; drop rows with wrong signs."""
        W, side = outcome.active, outcome.side
        inequality = self.lower < self.upper
        L = self.projection.L
        z = -np.linalg.solve(L.T, np.linalg.solve(L, self.qp.q + self.M.T @ lam))
        while True:
            z, lam = self._refine_on_set(W, side, z, lam)
            wrong = inequality[W] & (side[W] * lam[W] < 0.0)
            if not wrong.any():
                return z, lam
            lam[W[wrong]] = 0.0
            W = W[~wrong]

    def _refine_on_set(
        self, W: Indices, side: Vector, z: Vector, lam: Vector
    ) -> tuple[Vector, Vector]:
        """Refine z and multipliers on given active rows, with residuals in extended precision."""
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
