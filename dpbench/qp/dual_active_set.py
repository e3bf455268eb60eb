"""The dual active-set method that completes eq. 30-32 of the paper.

With P = L Lᵀ, x = Lᵀz, J = L⁻¹Mᵀ and M = [A; I], the QP is the projection of x0 = −L⁻¹q onto
lower ≤ Jᵀx ≤ upper, and M P⁻¹ Mᵀ = JᵀJ. For an active set W with limits g the paper's formulas are

    λ_W = −(M_W P⁻¹ M_Wᵀ)⁻¹(−g + M_W P⁻¹ q) = (J_WᵀJ_W)⁻¹(J_Wᵀx0 − g)                  (eq. 31)
    z = −P⁻¹(q + M_Wᵀ λ_W),     that is     x = x0 − J_W λ_W                             (eq. 32)

and eq. 30 requires the W whose multipliers all have the sign of their limit. The paper leaves open
which W to try next; here it is the rule of D. Goldfarb and A. Idnani, "A numerically stable dual
method for solving strictly convex quadratic programs", Math. Programming 27 (1983) 1-33: start from
the empty set (eq. 27), add the most violated row, and drop the row whose multiplier reaches zero
first. Every row added raises the dual objective strictly, and between two of them the set only
shrinks, so that no set returns and the method ends, degenerate or not (their theorem 3). Ties go to
the lowest index.

    J (n, p)    column i: row i of M in the coordinates x, of unit length (scaled by the caller)
    active W    positions k → rows i, in the order they came       J_W = Q R,  Q (n, w), R (w, w)
    side, lam   (p,) by row i, zero where it is not active

By hand, one step of the example in `solvers/own/active_set.c`: with J = [1 0 s; 0 1 s],
s = 1/√2, the limits (1, 1, 2.5 s) and x0 = (3, 3), the rows are violated by 2, 2 and 3.5 s = 2.47,
so that row 2 comes first and λ₂ = 3.5 s. Three more iterations end at x = (1, 1), λ = (2, 2, 0).

>>> s = 0.5**0.5
>>> J, upper = np.array([[1.0, 0.0, s], [0.0, 1.0, s]]), np.array([1.0, 1.0, 2.5 * s])
>>> method = DualActiveSet(J, np.array([3.0, 3.0]), -upper - 10.0, upper, limit=9)
>>> found, ending = method._find_most_violated_row_and_side(), method._activate_violated_row(2, 1.0)
>>> found, ending, bool(np.isclose(method._lam[2], 3.5 * s))
((2, 1.0), None, True)
>>> outcome = method.run()
>>> outcome.multipliers.round(12).tolist(), outcome.iterations
([2.0, 2.0, 0.0], 4)
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import scipy.linalg

from dpbench.arrays import Indices, Matrix, Vector

VIOLATED = 1e-14  # relative violation from which a row counts as violated
# A row is a combination of the active ones when less than this share of its length is left after
# projection: far above rounding (1e-15), far below any angle that a step could be taken along.
DEPENDENT = 1e-10
# A row whose share in such a combination is less has none: its multiplier would be driven to zero
# along rounding, which has no end.
NO_PART = 1e-9
# A violated dependent row is taken for a contradiction only when it is violated by more than this
# share; below, it is an active row written twice with rounding, and is set aside.
CONTRADICTION = 1e-11
# Rounding of x0 in x, relative to its length: at a vertex only the rest of two projections.
ROUNDING, AT_VERTEX = 1e-15, 1e-25
# A dependent row is an active one written twice if violated by no more than this before any step.
WRITTEN_TWICE = 1e-9
# A guard against rounding only: the method ends by itself, usually within n + m iterations.
ITERATIONS_PER_ROW = 5
_State = tuple[list[int], Vector, Vector, Matrix, Matrix]


class Ending(Enum):
    """Outcome of the dual active-set method: optimal, infeasible or iteration limit."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration limit"


@dataclass(eq=False)
class Outcome:
    """Result of the dual active-set method: final active set, multipliers and iteration count.

    active : rows of the final set; side : (p,) +1 where a row was added at its upper limit, −1 at
    its lower one; multipliers : (p,) signed, positive at an upper limit, at `INFEASIBLE` a Farkas
    ray; iterations : rows added or dropped.
    """

    ending: Ending
    active: Indices
    side: Vector
    multipliers: Vector
    iterations: int


class DualActiveSet:
    """Dual active-set solver for the projection of a point onto lower ≤ Jᵀx ≤ upper.

    J : (n, p) columns of unit length, or zero.
    x0 : (n,) the point to project.
    lower, upper : (p,) limits, lower ≤ upper; ±inf where there is none.
    limit : iterations after which to give up.
    """

    def __init__(self, J: Matrix, x0: Vector, lower: Vector, upper: Vector, *, limit: int) -> None:
        self._J, self._lower, self._upper, self._limit = J, lower, upper, limit
        self._free = lower == upper  # an equality, whose multiplier has either sign
        self._base = self._x = x0
        self._active: list[int] = []
        self._side, self._lam = np.zeros(J.shape[1]), np.zeros(J.shape[1])
        self._aside = np.zeros(J.shape[1], dtype=bool)
        self._Q, self._R = np.empty((x0.size, 0)), np.empty((0, 0))
        self.iterations = 0

    def run(self) -> Outcome:
        """Add violated rows to the active set until none is left or no step is possible."""
        while True:
            j, side = self._find_most_violated_row_and_side()
            if j < 0:
                return self._build_outcome(Ending.OPTIMAL)
            if (ending := self._activate_violated_row(j, side)) is not None:
                return self._build_outcome(ending)

    def _build_outcome(self, ending: Ending) -> Outcome:
        """Return the active set, multipliers and iterations with the way it ended."""
        active = np.array(self._active, dtype=np.intp)
        return Outcome(ending, active, self._side, self._lam, self.iterations)

    def _find_most_violated_row_and_side(self) -> tuple[int, float]:
        """Return the inactive row violated most, and +1 at its upper or −1 at its lower limit."""
        w = self._x @ self._J
        over, under = w - self._upper, self._lower - w
        noise = VIOLATED * float(np.max(np.abs(w), initial=0.0))
        vertex = len(self._active) == self._base.size
        noise += (AT_VERTEX if vertex else ROUNDING) * float(np.linalg.norm(self._base))
        excess = np.maximum(over, under)
        excess[self._active] = excess[self._aside] = -np.inf
        if excess.size == 0:
            return -1, 0.0
        j = int(np.argmax(excess))
        side = 1.0 if over[j] >= under[j] else -1.0
        limit = self._upper[j] if side > 0.0 else self._lower[j]
        if not excess[j] > noise + VIOLATED * abs(limit):
            return -1, 0.0
        return j, side

    def _activate_violated_row(self, j: int, side: float) -> Ending | None:
        """Raise a violated row's multiplier until the row is active; drop rows that block."""
        J, lam = self._J, self._lam
        limit = self._upper[j] if side > 0.0 else self._lower[j]
        self._side[j] = side
        before = self._active.copy(), lam.copy(), self._x, self._Q, self._R
        excess = side * (float(J[:, j] @ self._x) - limit)
        rounding = excess <= WRITTEN_TWICE * self._compute_reference_size_of_violation(limit)
        while self.iterations < self._limit:
            self.iterations += 1
            a = side * J[:, j]
            r, d = self._split_vector_along_active_normals(a)
            gap = float(a @ self._x) - side * limit
            dependent = len(self._active) == a.size or d @ d <= DEPENDENT**2 * (a @ a)
            blocking, t_dual = self._find_blocking_row_and_step_length(
                r, NO_PART if dependent else 0.0
            )
            t_primal = np.inf if dependent else max(gap, 0.0) / float(d @ d)
            if dependent and blocking < 0:
                if gap > CONTRADICTION * self._compute_reference_size_of_violation(limit):
                    # The ray that proves row j, dependent on the active ones, contradictory.
                    lam[:] = 0.0
                    lam[self._active], lam[j] = -r, side
                    return Ending.INFEASIBLE
                self._exclude_redundant_row(j, before if rounding else None)
                return None
            t = min(t_primal, t_dual)
            lam[self._active] -= t * r
            lam[j] += t * side
            self._x = self._x - t * d
            if t_primal <= t_dual:
                self._active.append(j)
                self._factor_active_normals_by_qr()
                self._recompute_point_and_multipliers()
                return None
            lam[self._active.pop(blocking)] = 0.0
            self._factor_active_normals_by_qr()
        return Ending.ITERATION_LIMIT

    def _factor_active_normals_by_qr(self) -> None:
        """Compute the QR factors of the active rows' normals."""
        self._Q, self._R = np.linalg.qr(self._J[:, self._active])

    def _split_vector_along_active_normals(self, a: Vector) -> tuple[Vector, Vector]:
        """Return a vector's coefficients in the active normals, and the rest orthogonal to them."""
        if not self._active:
            return np.empty(0), a
        c = self._Q.T @ a
        d = a - self._Q @ c
        again = self._Q.T @ d
        return _solve_triangular(self._R, c + again), d - self._Q @ again

    def _find_blocking_row_and_step_length(self, r: Vector, least: float) -> tuple[int, float]:
        """Return which active multiplier reaches zero first along a step, and that step length."""
        if not self._active:
            return -1, np.inf
        lam = self._lam[self._active]
        inequality = ~self._free[self._active]
        falling = inequality & (self._side[self._active] * r > least)
        if not falling.any():
            return -1, np.inf
        steps = np.full(lam.size, np.inf)
        steps[falling] = np.maximum(lam[falling] / r[falling], 0.0)
        # Of equal steps the lowest row, so that the path does not depend on the order of W.
        shortest = float(steps.min())
        ties = np.flatnonzero(steps == shortest)
        return int(min(ties, key=lambda k: self._active[k])), shortest

    def _recompute_point_and_multipliers(self) -> None:
        """Recompute point and multipliers from the active set, free of accumulated rounding."""
        W = self._active
        g = np.where(self._side[W] > 0.0, self._upper[W], self._lower[W])
        at_limits = _solve_triangular(self._R.T, g, lower=True)
        along = self._Q.T @ self._base
        self._lam[W] = _solve_triangular(self._R, along - at_limits)
        # Projected twice: x0 may be far longer than x, which is all of x0 that a vertex keeps.
        across = self._base - self._Q @ along
        self._x = across - self._Q @ (self._Q.T @ across - at_limits)

    def _compute_reference_size_of_violation(self, limit: float) -> float:
        """Return the size that a violation is relative to: |limit| plus the largest entry of x."""
        return abs(limit) + float(np.max(np.abs(self._x), initial=0.0))

    def _exclude_redundant_row(self, j: int, before: _State | None) -> None:
        """Exclude row j from the search: it repeats active rows up to rounding.

        If it was violated by no more than rounding at first, the steps since have followed nothing
        else: they are undone to `before`.
        """
        self._aside[j] = True
        if before is not None:
            self._active, self._lam, self._x, self._Q, self._R = before
        else:
            # What multiplier it has gathered stays a constant part of x.
            self._base = self._base - self._lam[j] * self._J[:, j]


def _solve_triangular(R: Matrix, b: Vector, *, lower: bool = False) -> Vector:
    """Solve R x = b with R upper or lower triangular."""
    x = scipy.linalg.solve_triangular(R, b, lower=lower, check_finite=False)
    return np.asarray(x, dtype=np.float64)


def find_active_set(P: Matrix, C: Matrix, q: Vector, lower: Vector, upper: Vector) -> Outcome:
    """Minimise ½ zᵀPz + qᵀz within limits (N,) of rows C (N, n) by the dual active-set method.

    LinAlgError if P (n, n) is not positive definite.
    """
    L = np.linalg.cholesky(0.5 * (P + P.T)).astype(np.float64)
    J = scipy.linalg.solve_triangular(L, C.T, lower=True)
    length = np.linalg.norm(J, axis=0)
    scale = np.ones(length.size)
    np.divide(1.0, length, out=scale, where=length > 0.0)
    x0 = -np.linalg.solve(L, q).astype(np.float64)
    limit = ITERATIONS_PER_ROW * scale.size
    outcome = DualActiveSet(J * scale, x0, lower * scale, upper * scale, limit=limit).run()
    return replace(outcome, multipliers=outcome.multipliers * scale)
