"""Rational certificate: the optimum by an active-set method in exact arithmetic.

The dual method of Goldfarb and Idnani (Mathematical Programming 27, 1983): from multipliers of the
right sign, add the most violated row, and drop the rows whose multipliers reach zero on the way.
The dual objective rises strictly with every row added, so that in exact arithmetic it ends, at the
optimum or at a proof that there is no feasible point, however degenerate the problem.

All data are scaled by powers of two to integers: with P = 2^p P', C = 2^c C', z = 2^e z',
q = 2^(p+e) q', [L; U] = 2^(c+e) [L'; U'], the multipliers are λ = 2^(p+e−c) λ'.

A set W is solved for two right-hand sides at once, in integers over one positive denominator: the
point, and its change when the multiplier μ of a row g to be added grows by 1.

              n    w                                 point   slope
        n  ┌  P   Gᵀ ┐   ┌ z  dz/dμ ┐           ┌     −q      −g  ┐
        w  └  G   0  ┘   └ λ  dλ/dμ ┘     =     └   limits     0  ┘        G = C_W

By hand, the point nearest (1, ½) with 3 z₁ ≤ 1: alone, z = (1, ½) violates the row g = (3, 0) by 2.
Along μ, dz/dμ = −g, so that g·z falls by 9 for 1 of μ: at μ = 2/9 the row is met, W = {0} has
G = (3, 0), z = (⅓, ½) and λ = 2/9, both exact. Rounded once, ⅓ is off by ⅓·2⁻⁵⁴.

>>> from dpbench.qp.program import QuadraticProgram
>>> free = np.full(2, np.inf)
>>> row = [[3, 0]], [-np.inf], [1], -free, free
>>> problem = JointQP.from_qp(QuadraticProgram(np.eye(2), [-1, -0.5], *row))
>>> exact = ExactMatrices.from_float_matrices(problem.P, problem.C)
>>> qp, no_guess = _IntegerQP.from_joint_qp(problem, exact), np.zeros(3, dtype=np.int8)
>>> active, at = _build_dual_feasible_start(qp, no_guess)
>>> unit = Fraction(2) ** qp.z_exponent
>>> [str(Fraction(z, at.denominator) * unit) for z in at.point]
['1', '1/2']
>>> proof = _add_violated_limit_or_return_farkas_vector(qp, active, 0, 1)
>>> _find_most_violated_row_and_sign(qp, at), proof, active.rows
((0, 1), None, [0])
>>> at = active.solve_kkt_exactly(np.zeros(2, dtype=object))
>>> [str(Fraction(z, at.denominator) * unit) for z in at.point[:2]]
['1/3', '1/2']
>>> str(Fraction(at.point[2], at.denominator) * Fraction(2) ** qp.y_exponent)
'2/9'
>>> proof = prove_optimum_in_exact_arithmetic(problem, exact, no_guess)
>>> proof.z.tolist() == [1 / 3, 1 / 2], bool(np.isclose(proof.bound, 2**-54 / 3, rtol=1e-9, atol=0))
(True, True)
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.referee.dyadic import Dyadic, Whole, solve_integer_system_exactly
from dpbench.qp.referee.optimum import ExactMatrices, JointQP, Proof, Signs


@dataclass(frozen=True, slots=True, eq=False)
class _IntegerQP:
    """QP with all data scaled to integers; limits are None where infinite."""

    P: Whole
    q: Whole
    C: Whole
    lower: list[int | None]
    upper: list[int | None]
    z_exponent: int
    y_exponent: int

    @classmethod
    def from_joint_qp(cls, problem: JointQP, exact: ExactMatrices) -> "_IntegerQP":
        """Convert a QP to integers, with powers of two as units."""
        q = Dyadic.from_floats(problem.q)
        L, U = (
            Dyadic.from_floats(np.nan_to_num(x, posinf=0.0, neginf=0.0))
            for x in (problem.L, problem.U)
        )
        p, c = exact.P.exponent, exact.C.exponent
        e = min(q.exponent - p, L.exponent - c, U.exponent - c)
        limits = (
            _list_integer_limits_or_none(L.integers_at_exponent(c + e), problem.L),
            _list_integer_limits_or_none(U.integers_at_exponent(c + e), problem.U),
        )
        return cls(
            exact.P.whole, q.integers_at_exponent(p + e), exact.C.whole, *limits, e, p + e - c
        )


def _list_integer_limits_or_none(numbers: Whole, given: Vector) -> list[int | None]:
    """Return the integer limits as a list, None where the given limit is infinite."""
    finite = np.isfinite(given).tolist()
    return [x if there else None for x, there in zip(numbers.tolist(), finite, strict=True)]


@dataclass(slots=True)
class _ExactPoint:
    """Exact point and multipliers, and their change per unit of a new row's multiplier."""

    point: Whole
    slope: Whole
    denominator: int


class _ActiveSet:
    """Constraint rows held at a limit: side +1 the upper, −1 the lower one, 0 an equality."""

    def __init__(self, qp: _IntegerQP) -> None:
        self.qp = qp
        self.rows: list[int] = []
        self.side: list[int] = []

    def add_row_at_limit(self, row: int, sign: int) -> None:
        """Add a row at its upper (+1) or lower (−1) limit to the exact active set."""
        self.rows.append(row)
        equal = self.qp.lower[row] == self.qp.upper[row]
        self.side.append(0 if equal else sign)

    def drop_row_at_position(self, position: int) -> None:
        """Remove the row at a position of the exact active set."""
        del self.rows[position], self.side[position]

    def solve_kkt_exactly(self, gradient: Whole) -> _ExactPoint | None:
        """Solve the held rows' KKT system exactly, and a new row's gradient; None if singular."""
        qp, n, w = self.qp, len(self.qp.q), len(self.rows)
        G = qp.C[self.rows]
        K = np.zeros((n + w, n + w), dtype=object)
        K[:n, :n], K[n:, :n], K[:n, n:] = qp.P, G, G.T
        rhs = np.zeros((n + w, 2), dtype=object)
        rhs[:n, 0], rhs[:n, 1] = -qp.q, -gradient
        sides = zip(self.rows, self.side, strict=True)
        rhs[n:, 0] = [qp.lower[row] if side < 0 else qp.upper[row] for row, side in sides]
        solved = solve_integer_system_exactly(K, rhs)
        if solved is None:
            return None
        x, denominator = solved
        return _ExactPoint(x[:, 0], x[:, 1], denominator)

    def find_position_of_most_wrong_multiplier(self, multipliers: Whole) -> int | None:
        """Return the position of the multiplier of the most wrong sign, or None."""
        values = [side * lam for side, lam in zip(self.side, multipliers, strict=True)]
        worst = min(range(len(values)), key=values.__getitem__, default=None)
        return worst if worst is not None and values[worst] < 0 else None

    def find_first_multiplier_to_reach_zero(self, at: _ExactPoint) -> tuple[Fraction, int] | None:
        """Return how far a new row's multiplier can rise until another is zero, and that one."""
        n = len(self.qp.q)
        multipliers = enumerate(zip(self.side, at.point[n:], at.slope[n:], strict=True))
        zeros = (
            (Fraction(-value, slope), position)
            for position, (side, value, slope) in multipliers
            if side * slope < 0
        )
        return min(zeros, default=None)


def _find_most_violated_row_and_sign(qp: _IntegerQP, at: _ExactPoint) -> tuple[int, int] | None:
    """Return row and sign of the limit that the point violates most; None if feasible."""
    value = qp.C @ at.point[: len(qp.q)]
    violation, limit = 0, None
    for row, number in enumerate(value.tolist()):
        lower, upper = qp.lower[row], qp.upper[row]
        above = 0 if upper is None else number - upper * at.denominator
        below = 0 if lower is None else lower * at.denominator - number
        if max(above, below) > violation:
            violation, limit = max(above, below), (row, 1 if above > below else -1)
    return limit


def _build_dual_feasible_start(
    qp: _IntegerQP, signs: Signs
) -> tuple[_ActiveSet, _ExactPoint] | None:
    """Return a dual-feasible active set and its exact point, starting from a guess."""
    active = _ActiveSet(qp)
    for row in np.flatnonzero(signs).tolist():
        active.add_row_at_limit(row, int(signs[row]))
    nothing = np.zeros(len(qp.q), dtype=object)
    while True:
        at = active.solve_kkt_exactly(nothing)
        if at is None:
            return None if not active.rows else _build_dual_feasible_start(qp, np.zeros_like(signs))
        worst = active.find_position_of_most_wrong_multiplier(at.point[len(qp.q) :])
        if worst is None:
            return active, at
        active.drop_row_at_position(worst)


def prove_optimum_in_exact_arithmetic(
    problem: JointQP, exact: ExactMatrices, signs: Signs
) -> Proof | None:
    """Certify the optimum by an active-set method in exact rational arithmetic.

    `problem` must have positive definite P and L ≤ U; `signs` is a guess of the active set, which
    decides the time only. Where there is no optimum, the proof is of kind "infeasible" with the
    Farkas multipliers y (N,), z NaN and bound inf; None when P turns out singular.
    """
    qp = _IntegerQP.from_joint_qp(problem, exact)
    started = _build_dual_feasible_start(qp, signs)
    if started is None:
        return None
    active, at = started
    while (violated := _find_most_violated_row_and_sign(qp, at)) is not None:
        row, sign = violated
        farkas = _add_violated_limit_or_return_farkas_vector(qp, active, row, sign)
        if farkas is not None:
            return Proof(np.full(len(qp.q), np.nan), farkas, np.inf, "infeasible")
        settled = active.solve_kkt_exactly(np.zeros(len(qp.q), dtype=object))
        if settled is None:
            return None
        at = settled
    return _round_exact_point_to_proof(qp, active, at)


def _add_violated_limit_or_return_farkas_vector(
    qp: _IntegerQP, active: _ActiveSet, row: int, sign: int
) -> Vector | None:
    """Add a violated limit to the active set; return Farkas multipliers if that is impossible."""
    gradient = sign * qp.C[row]
    limit = sign * ((qp.upper[row] if sign > 0 else qp.lower[row]) or 0)
    while True:
        at = active.solve_kkt_exactly(gradient)
        assert at is not None, "rows of the active set are independent"
        n = len(qp.q)
        slope = int(gradient @ at.slope[:n])
        violation = int(gradient @ at.point[:n]) - limit * at.denominator
        reached = Fraction(violation, -slope) if slope < 0 else None
        blocked = active.find_first_multiplier_to_reach_zero(at)
        if reached is not None and (blocked is None or reached <= blocked[0]):
            active.add_row_at_limit(row, sign)
            return None
        if blocked is None:
            return _build_farkas_vector_of_violated_row(qp, active, at, row, sign)
        active.drop_row_at_position(blocked[1])


def _build_farkas_vector_of_violated_row(
    qp: _IntegerQP, active: _ActiveSet, at: _ExactPoint, row: int, sign: int
) -> Vector:
    """Return the multipliers (N,) that prove the violated row contradicts the active rows."""
    y = np.zeros(len(qp.lower))
    y[row] = sign
    for position, held in enumerate(active.rows):
        y[held] += float(Fraction(at.slope[len(qp.q) + position], at.denominator))
    return y


def _round_exact_point_to_proof(qp: _IntegerQP, active: _ActiveSet, at: _ExactPoint) -> Proof:
    """Return the exact point rounded to float64, with its rounding error as the bound."""
    n = len(qp.q)
    unit = Fraction(2) ** qp.z_exponent
    exact_z = [Fraction(number, at.denominator) * unit for number in at.point[:n]]
    z = np.array([float(value) for value in exact_z])
    off = max(abs(value - Fraction(near)) for value, near in zip(exact_z, z.tolist(), strict=True))
    y = np.zeros(len(qp.lower))
    y_unit = Fraction(2) ** qp.y_exponent
    for position, row in enumerate(active.rows):
        y[row] = float(Fraction(at.point[n + position], at.denominator) * y_unit)
    return Proof(z, y, float(np.nextafter(float(off), np.inf)), "rational")
