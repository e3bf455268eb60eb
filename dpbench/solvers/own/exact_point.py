"""A proof that an answer is near the optimum where the feasible set leaves limits no room to move.

The answer is moved onto the limits it touches in exact arithmetic, to z′. If that satisfies every
limit to the last bit, then with multipliers λ whose signs name finite limits

    ½ (z′ − z*)ᵀP(z′ − z*) ≤ Σ λ⁺(U − C z′) + Σ λ⁻(C z′ − L) + ½ rᵀP⁻¹r,   r = P z′ + q + Cᵀλ

Of all N = m + n rows of C = [A; I] those that z touches are `near`, independent ones among these
are `held`, and only as many `columns` of z as there are held rows are moved:

              columns   others
           ┌──────────┬────────┐                 K δ = limits − C_B z,  a square system of integers
    held B │    K     │  kept  │  z + δ          times powers of two; its rows are put in an order
           ├──────────┼────────┤                 in which elimination meets no zero pivot
    near   │  then checked, δ and all, in exact arithmetic

An example to follow by hand: 3 z₁ ≤ 1 and z₁ + z₂ ≤ 1 meet at (⅓, ⅔), which no float64 is. With
ε = 2⁻⁵⁴ the nearest ones are ⅓ − ε/3 and ⅔ − 2ε/3: both rows are short of their limit by exactly ε,
and 3 δ₁ = ε, δ₁ + δ₂ = ε give δ = (ε/3, 2ε/3). With P = I and q = (−2, −2) the slope there is
(−5/3, −4/3) = −λ₀ (3, 0) − λ₁ (1, 1) for λ = (1/9, 4/3): z′ is the optimum, no limit has a slack,
and what is left of the bound is the rounding of r, 2·2.3e-16 of terms that add up to 4 in either
entry: √2 · 1.8e-15 = 2.6e-15.

>>> from dpbench.qp.program import QuadraticProgram
>>> free = np.full(2, inf)
>>> meeting = [[3, 0], [1, 1]], -free, [1, 1], -free, free
>>> problem = JointQP.of(QuadraticProgram(np.eye(2), [-2, -2], *meeting))
>>> z, limit = np.array([1 / 3, 2 / 3]), np.array([1.0, 1.0, inf, inf])
>>> moved = _ExactPoint.move_onto_limits(problem, z, np.array([0, 1]), limit)
>>> unit = Fraction(2) ** moved.exponent / moved.denominator
>>> delta = dict(zip(moved.columns.tolist(), [int(x) * unit for x in moved.step], strict=True))
>>> delta == {0: Fraction(1, 3 * 2**54), 1: Fraction(2, 3 * 2**54)}
True
>>> [moved.excess_over(row, limit) for row, limit in ((0, 1.0), (1, 1.0), (1, 1.0 + 2**-52))]
[0.0, 0.0, -2.220446049250313e-16]
>>> 2.6e-15 < error_bound(problem, z, np.array([1 / 9, 4 / 3, 0.0, 0.0])) < 4e-15
True

Whether rounding decides where the compiled method's answer lies.

Where limits meet at an angle that is next to nothing, the optimality conditions hold to the last
digit at points far from the optimum; so they do where the cost hardly curves. Limits and cost are
therefore moved, by `MOVED` times what rounding leaves in a row and in the gradient, and the problem
is solved again: an answer that follows by more than `MOVED` times what an answer may be wrong is
none. The cost is moved where it matters most, both ways. All limits are tightened, all are widened,
and then one half against the other, so that of every two rows either is moved in while the other is
moved out.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf, nan

import numpy as np
import scipy.linalg

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.dyadic import Dyadic, Whole, solve_integer
from dpbench.qp.referee.gap import find_met_limits, select_independent
from dpbench.qp.referee.joint import JointQP
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.check import EPSILON, WRONG
from dpbench.solvers.own.active_set.factor import VIOLATED
from dpbench.solvers.own.active_set.kernel import solve_step
from dpbench.solvers.own.active_set.start import STEEP
from dpbench.solvers.own.proof import INDEPENDENT, has_independent_rows, solve_carefully

LARGEST = 40
"""Equations to be solved in exact arithmetic, which takes 0.1 s for as many."""


def error_bound(problem: JointQP, z: Vector, lam: Vector) -> float:
    """Bound the error max_i |z_i − z*_i| of a QP's answer z by an exactly feasible point near it.

    inf where there is no such z′ or λ names an infinite limit; NaN beyond `LARGEST` equations.

    Parameters
    ----------
    problem : with a positive definite P.
    z, lam : (n,), (N,) an answer and its multipliers.
    """
    signs = np.where(lam == 0.0, find_met_limits(problem, z), np.sign(lam)).astype(np.int8)
    limit = np.where(signs > 0, problem.U, problem.L)
    near = np.flatnonzero(signs)
    if not np.isfinite(limit[near]).all():
        return inf
    held = np.flatnonzero(select_independent(problem.C, signs, np.sign(lam).astype(np.int8)))
    if len(held) > LARGEST:
        return nan
    exact = _ExactPoint.move_onto_limits(problem, z, held, limit)
    if exact is None or not exact.is_feasible(near):
        return inf
    gap = sum(abs(lam[i]) * abs(exact.excess_over(i, limit[i])) for i in near[lam[near] != 0.0])
    return _distance_bound(problem, z, lam, float(gap)) + exact.size()


def is_regular_vertex(problem: JointQP, z: Vector) -> bool:
    """Return whether limits met at z are independent enough that rounding moves z little."""
    return has_independent_rows(problem.C[find_met_limits(problem, z) != 0], STEEP)


@dataclass(frozen=True, slots=True, eq=False)
class _ExactPoint:
    """A point near answer z, in exact rational numbers: z plus shifts of a few variables."""

    problem: JointQP
    z: Dyadic
    columns: Indices
    step: Whole
    denominator: int
    exponent: int

    @classmethod
    def move_onto_limits(
        cls, problem: JointQP, z: Vector, held: Indices, limit: Vector
    ) -> _ExactPoint | None:
        """Move z exactly onto the limits of the rows numbered `held`; None if dependent."""
        start, columns = Dyadic.of(z), _pivot_columns(problem.C[held])
        held = held[_elimination_order(problem.C[np.ix_(held, columns)])]
        K = Dyadic.of(problem.C[np.ix_(held, columns)])
        missing = Dyadic.of(limit[held]) - Dyadic.of(problem.C[held]) @ start
        solved = solve_integer(K.whole, missing.whole[:, np.newaxis])
        if solved is None:
            return None
        step, denominator = solved[0][:, 0], solved[1]
        return cls(problem, start, columns, step, denominator, missing.exponent - K.exponent)

    def size(self) -> float:
        """Return the largest shift of a variable, max_i |δ_i|."""
        unit = Fraction(2) ** self.exponent / self.denominator
        return max((abs(float(int(x) * unit)) for x in self.step), default=0.0)

    def excess_over(self, row: int, limit: float) -> float:
        """Return an exact point's row value minus a limit of that row, rounded only once."""
        C = Dyadic.of(self.problem.C[[row]])
        over = C @ self.z - Dyadic.of(np.array([limit]))
        along = C.whole[0, self.columns] @ self.step if len(self.step) else 0
        value = Fraction(2) ** over.exponent * int(over.whole[0])
        unit = Fraction(2) ** (C.exponent + self.exponent) / self.denominator
        return float(value + int(along) * unit)

    def is_feasible(self, rows: Indices) -> bool:
        """Return whether the exact point satisfies both limits of each numbered row."""
        L, U = self.problem.L, self.problem.U
        for i in rows:
            if U[i] < inf and self.excess_over(i, U[i]) > 0.0:
                return False
            if L[i] > -inf and self.excess_over(i, L[i]) < 0.0:
                return False
        return True


def _pivot_columns(C: Matrix) -> Indices:
    """Return columns of C, as many as rows, that form a nonsingular square matrix."""
    if not len(C):
        return np.array([], dtype=np.intp)
    _, order = scipy.linalg.qr(C, mode="r", pivoting=True)
    return np.asarray(order[: len(C)], dtype=np.intp)


def _elimination_order(square: Matrix) -> Indices:
    """Return an order of a matrix's rows in which Gaussian elimination meets no zero pivot."""
    if not len(square):
        return np.array([], dtype=np.intp)
    permutation, _, _ = scipy.linalg.lu(square, p_indices=True)
    return np.argsort(permutation)


def _distance_bound(problem: JointQP, z: Vector, lam: Vector, gap: float) -> float:
    """Bound the distance max_i |z_i − z*_i| to the optimum by duality gap and gradient residual."""
    P, C = problem.P, problem.C
    r = P @ z + problem.q + lam @ C
    terms = np.abs(P) @ np.abs(z) + np.abs(problem.q) + np.abs(lam) @ np.abs(C)
    r = np.abs(r) + EPSILON * len(z) * terms
    inverse = np.linalg.inv(P)
    gap += 0.5 * float(r @ np.abs(inverse) @ r)
    return float(np.sqrt(2.0 * gap * np.diagonal(inverse).max()))


MOVED = 2e4
"""Enough for a dependent row that is violated by as much to be seen as a contradiction."""
OFF = 10.0
"""Roundings by which a row may be missed that has no room to be moved as far."""
HALVES = 6
"""Ways of halving the rows: any two of the 64 nearest their limits are apart in one of them."""


def moves_under_small_shifts(S: Matrix, qp: QuadraticProgram) -> bool:
    """Return whether tiny shifts of limits and cost change the QP's answer by more than allowed."""
    n_pad = int(S[layout.HEAD, layout.N_PAD])
    vectors, factor = S[: layout.VECTORS], S[-n_pad:]
    before = vectors.copy(), factor.copy()
    z = S[layout.Z, : qp.n].copy()
    posed = JointQP.of(qp)
    columns = np.concatenate([n_pad + np.arange(qp.m), np.arange(qp.n)])
    far = _limit_shifts(posed, z, S[layout.UNIT, columns])
    if far is None:
        return True
    inverse = S[layout.VECTORS : layout.VECTORS + qp.n, : qp.n]
    allowed = MOVED * WRONG * error_units(qp)
    lam = S[layout.LAM, columns]
    along, start = _worst_cost_shift(posed, z, lam, inverse), np.sign(lam)
    try:
        for k, sides in enumerate(_list_shift_signs(posed, z)):
            S[layout.Q, : qp.n] = qp.q + (along if k % 2 else -along)
            S[layout.LOW, columns] = posed.L - sides * far
            S[layout.HIGH, columns] = posed.U + sides * far
            ending = solve_step(S)
            # The careful method takes a second at n = 200: it is asked where all limits move.
            if ending != layout.UNDECIDED or k < 2:
                followed = _read_or_solve_answer(S, qp, columns, ending, start)
                if not (np.abs(followed - z) <= allowed).all():
                    return True
            vectors[:], factor[:] = before
        return False
    finally:
        vectors[:], factor[:] = before


def error_units(qp: QuadraticProgram) -> Vector:
    """Return the unit for each variable's error: half its bound range, at least 1."""
    half = 0.5 * (qp.ub - qp.lb)
    return np.where(np.isfinite(half), np.maximum(half, 1.0), 1.0)


def _read_or_solve_answer(
    S: Matrix, qp: QuadraticProgram, columns: Indices, ending: int, start: Vector
) -> Vector:
    """Return the answer of a QP with shifted limits, solved again if undecided; NaN if none."""
    if ending >= 0 or ending == layout.DOUBTFUL:
        return S[layout.Z, : qp.n]
    if ending == layout.UNDECIDED:
        low, high = S[layout.LOW, columns], S[layout.HIGH, columns]
        l, lb = low[: qp.m], low[qp.m :]  # noqa: E741 - l ≤ Az ≤ u, the name of the field
        u, ub = high[: qp.m], high[qp.m :]
        moved = QuadraticProgram(qp.P, S[layout.Q, : qp.n].copy(), qp.A, l, u, lb, ub)
        return solve_carefully(moved, start=start).z
    return np.full(qp.n, np.nan)


def _limit_shifts(posed: JointQP, z: Vector, unit: Vector) -> Vector | None:
    """Return how far to shift each row's limits to test an answer; None if rows are in doubt.

    In doubt: those that cannot be moved as far and are violated or dependent on one another. A row
    does not cross itself; one with equal limits stays (`proof.has_consistent_equalities`).
    """
    value = posed.C @ z
    rounding = VIOLATED * (np.abs(value) + np.linalg.norm(value * unit) / unit)
    violation = np.maximum(value - posed.U, posed.L - value)
    far, room = MOVED * np.maximum(rounding, violation), 0.25 * (posed.U - posed.L)
    # A row of zeros is no row.
    far[~posed.C.any(axis=1)] = 0.0
    narrow = room < far
    if (violation > OFF * rounding)[narrow].any():
        return None
    if (room[narrow] > 0.0).any() and not has_independent_rows(posed.C[narrow], INDEPENDENT):
        return None
    return np.minimum(far, room)


def _worst_cost_shift(posed: JointQP, z: Vector, lam: Vector, inverse: Matrix) -> Vector:
    """Return the shift of q, within rounding and residual, that moves the optimum most."""
    terms = np.abs(posed.q) + np.abs(posed.P) @ np.abs(z) + np.abs(lam) @ np.abs(posed.C)
    r = posed.q + posed.P @ z + lam @ posed.C
    size = MOVED * np.maximum(EPSILON * terms, np.abs(r))
    most = int(np.argmax(np.abs(inverse) @ size))
    return np.asarray(np.sign(inverse[most]) * size)


def _list_shift_signs(posed: JointQP, z: Vector) -> list[Vector]:
    """List which rows to tighten (−1) or widen (+1) in each test: all rows, then halves of them."""
    value = posed.C @ z
    nearest = np.argsort(np.minimum(posed.U - value, value - posed.L), kind="stable")
    place = np.empty_like(nearest)
    place[nearest] = np.arange(len(nearest))
    one = np.ones(len(value))
    ways = [one, *(np.where(place >> bit & 1, one, -one) for bit in range(HALVES))]
    return [side for way in ways for side in (-way, way)]
