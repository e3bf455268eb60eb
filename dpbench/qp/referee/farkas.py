"""Certificates that a QP has no feasible point, or no lower bound; decided exactly.

    Farkas:     Aᵀy + y_box = 0,  Σ u y⁺ − Σ l y⁻ + Σ ub y_box⁺ − Σ lb y_box⁻ < 0,
                y± = max(±y, 0), a positive part only on finite upper limits, a negative one only
                on finite lower limits
    unbounded:  Pd = 0, qᵀd < 0, d in the recession cone of the limits

A feasible z would give 0 = zᵀ(Aᵀy + y_box) ≤ the sum on the left of "< 0".

Infeasibility may be one by rounding: the problem was feasible before its numbers were rounded.

    t* = the least t for which some z has  L − t·s ≤ C z ≤ U + t·s,   C = [A; I]
    undecided:  t* ≤ γ_{n+2} = (n+2)·u / (1 − (n+2)·u),  u = 2^−53

s is the size of the numbers that a limit and its row are made of:

    s_i = |limit_i| + Σ_j |c_ij|·Z_j,   Z_j = min_k |limit_k / c_kj|

with the minimum over all limits that mention variable j, those left out that are themselves no
more than the rounding of the median of them. Evaluating row i in float64 at a point of that size
is off by up to γ_{n+1}·Σ_j|c_ij||z_j|, comparing it with its limit by one rounding more (Higham,
Accuracy and Stability, 3.1), and a z that violates rows by no more than γ·s satisfies exactly a
problem whose numbers are rounded a little differently (Oettli and Prager, Numer. Math. 6, 1964).
In float64 neither answer can be proven for such a problem as meant, and both are accepted. A row
whose coefficients are all rounding of their columns, such as 0·z ≤ −7e-18, has no size of its own;
it takes the median of |limit| of the other rows, or of the bounds if there are none.

The converse does not hold: a feasible set that a change of a few units in the last place would
empty (equality rows, dependent ones, limits that force a vertex) stays feasible, because every
solver accepts violations up to a tolerance far above rounding.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from math import lcm
from typing import Any

import numpy as np
from scipy.optimize import linprog

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.kernels import OUTWARD, UNDERFLOW
from dpbench.qp.referee.optimum import JointQP

CONSISTENT = 1e-6  # relative error of Aᵀy + y_box = 0 in a claimed vector
DENOMINATORS = (1, 12, 60, 1000)  # of fractions near a vector, tried in turn
UNIT_ROUNDOFF = 2.0**-53
ENDLESS = 1e20  # A limit this large stands for none, whatever its writer used for infinity
ROUNDS = 6  # Linear programs per search: each gains some six digits of the violation
GAIN = 1e6  # How much finer the violation is resolved from one linear program to the next


def make_farkas_vector_of_crossed_limits(qp: QuadraticProgram) -> Vector | None:
    """Return a Farkas vector (m + n,) of a row or bound with lower limit above upper, or None."""
    problem = JointQP.from_qp(qp)
    crossing = np.flatnonzero(problem.L > problem.U)
    if not len(crossing):
        return None
    return np.asarray(np.eye(len(problem.L))[crossing[0]])


def is_farkas_vector_proof(qp: QuadraticProgram, y: Vector, y_box: Vector) -> bool:
    """Return whether the Farkas vector (y, y_box) proves that the QP has no feasible point.

    y_box must satisfy Aᵀy + y_box = 0 to within `CONSISTENT`; it is then replaced by the exact
    −Aᵀy, whose sign must name finite bounds. A multiple of the unit vector of a row with l > u
    stands for both of its limits at once (y⁺ = y⁻) and is valid too.
    """
    y, y_box = np.asarray(y, dtype=np.float64), np.asarray(y_box, dtype=np.float64)
    if y.shape != (qp.m,) or y_box.shape != (qp.n,):
        return False
    if not (np.isfinite(y).all() and np.isfinite(y_box).all() and np.isfinite(qp.A).all()):
        return False
    both = np.concatenate((y, y_box))
    used = np.flatnonzero(both)
    if len(used) == 1:
        problem = JointQP.from_qp(qp)
        if problem.L[used[0]] > problem.U[used[0]]:
            return True
    box = -(Dyadic.from_floats(qp.A.T) @ Dyadic.from_floats(y))
    size = float(np.abs(qp.A).T.dot(np.abs(y)).max(initial=0.0)) + float(np.abs(y_box).max())
    if np.abs(box.round_to_floats() - y_box).max() > CONSISTENT * size:
        return False
    rows = _sum_weighted_limits_exactly(Dyadic.from_floats(y), qp.l, qp.u)
    bounds = _sum_weighted_limits_exactly(box, qp.lb, qp.ub)
    return rows is not None and bounds is not None and bool((rows + bounds).entry_signs() < 0)


def _sum_weighted_limits_exactly(y: Dyadic, lower: Vector, upper: Vector) -> Dyadic | None:
    """Return Σ upper·y⁺ − Σ lower·y⁻ exactly; None where a sign names an infinite limit."""
    signs = y.entry_signs()
    limits = np.where(signs > 0, upper, lower)
    used = signs != 0
    if not np.isfinite(limits[used]).all():
        return None
    return (y[used] * Dyadic.from_floats(limits[used])).exact_sum()


def find_farkas_vector(qp: QuadraticProgram) -> tuple[Vector, Vector] | None:
    """Find a Farkas vector (y, y_box) that proves the QP infeasible, or return None.

    From a linear program over the signed parts of (y, y_box), normalised to sum 1, then verified
    exactly; with infinite bounds also as small fractions, since Aᵀy = 0 has to be exact there.
    """
    unit = make_farkas_vector_of_crossed_limits(qp)
    if unit is not None:
        return unit[: qp.m], unit[qp.m :]
    problem = JointQP.from_qp(qp)
    upper, lower = np.flatnonzero(np.isfinite(problem.U)), np.flatnonzero(np.isfinite(problem.L))
    cost = np.concatenate((problem.U[upper], -problem.L[lower]))
    if not len(cost):
        return None
    balance = np.concatenate((problem.C[upper], -problem.C[lower])).T
    answer = linprog(cost, np.ones((1, len(cost))), [1.0], balance, np.zeros(qp.n))
    if answer.x is None or answer.fun is None or not answer.fun < 0.0:
        return None
    both = np.zeros(len(problem.L))
    np.add.at(both, upper, answer.x[: len(upper)])
    np.subtract.at(both, lower, answer.x[len(upper) :])
    return find_farkas_vector_near_candidate(qp, both)


def find_farkas_vector_near_candidate(
    qp: QuadraticProgram, both: Vector
) -> tuple[Vector, Vector] | None:
    """Find a valid Farkas vector (y, y_box) near a candidate (m + n,), or return None."""
    for y in chain((both[: qp.m],), _yield_integer_roundings_coarsest_first(both[: qp.m])):
        y_box = -(y @ qp.A)
        if is_farkas_vector_proof(qp, y, y_box):
            return y, y_box
    return None


def _yield_integer_roundings_coarsest_first(vector: Vector) -> Iterator[Vector]:
    """Yield integer vectors in nearly the proportions of `vector`, coarsest first."""
    size = float(np.abs(vector).max(initial=0.0))
    smallest = float(np.abs(vector[np.abs(vector) > 1e-7 * size]).min(initial=size))
    for unit in {size, smallest} - {0.0}:
        for limit in DENOMINATORS:
            whole = round_to_integer_proportions(vector / unit, limit)
            if whole is not None:
                yield whole


def round_to_integer_proportions(vector: Vector, denominator: int) -> Vector | None:
    """Return integers near the proportions of a vector; None where float64 has none."""
    parts = [Fraction(value).limit_denominator(denominator) for value in vector.tolist()]
    common = lcm(*(part.denominator for part in parts))
    numbers = [part * common for part in parts]
    if any(abs(number) >= 1 << 53 for number in numbers):
        return None
    return np.array([float(number) for number in numbers])


def is_direction_proof_of_unboundedness(qp: QuadraticProgram, d: Vector) -> bool:
    """Return whether direction d proves that the QP is unbounded below."""
    d = np.asarray(d, dtype=np.float64)
    if d.shape != (qp.n,) or not np.isfinite(d).all():
        return False
    exact = Dyadic.from_floats(d)
    if (Dyadic.from_floats(qp.P) @ exact).entry_signs().any():
        return False
    if not (Dyadic.from_floats(qp.q) * exact).exact_sum().entry_signs() < 0:
        return False
    problem = JointQP.from_qp(qp)
    moves = (Dyadic.from_floats(problem.C) @ exact).entry_signs()
    return not ((moves > 0) & np.isfinite(problem.U) | (moves < 0) & np.isfinite(problem.L)).any()


def find_unbounded_direction(qp: QuadraticProgram) -> Vector | None:
    """Find a direction (n,) that proves the QP unbounded below, or return None."""
    problem = JointQP.from_qp(qp)
    above, below = np.isfinite(problem.U), np.isfinite(problem.L)
    cone = np.vstack((problem.C[above], -problem.C[below]))
    rows: dict[str, Any] = {"A_ub": cone, "b_ub": np.zeros(len(cone))} if len(cone) else {}
    answer = linprog(qp.q, A_eq=qp.P, b_eq=np.zeros(qp.n), bounds=(-1.0, 1.0), **rows)
    if answer.x is None or answer.fun is None or not answer.fun < 0.0:
        return None
    candidates = chain((answer.x,), _yield_integer_roundings_coarsest_first(answer.x))
    return next((d for d in candidates if is_direction_proof_of_unboundedness(qp, d)), None)


@dataclass(frozen=True, slots=True)
class LeastViolation:
    """Rigorous bounds of the least relative constraint violation of a QP without feasible point.

    lower : by a Farkas vector, 0 without one; upper : by a point, inf where none was found or
    `lower` > `rounding`; rounding : γ_{n+2}.
    """

    lower: float
    upper: float
    rounding: float

    @property
    def is_undecided(self) -> bool:
        """Return whether the violation is within rounding, so that feasibility is undecided."""
        return self.upper <= self.rounding


def bound_least_constraint_violation(
    qp: QuadraticProgram, y: Vector | None = None
) -> LeastViolation:
    """Bound the least relative constraint violation of a QP without a feasible point.

    y (m + n,) is a valid Farkas vector (y, y_box), if one is known.
    """
    problem = JointQP.from_qp(qp)
    upper, lower = compute_reference_sizes_of_limits(problem)
    steps = qp.n + 2
    rounding = steps * UNIT_ROUNDOFF / (1.0 - steps * UNIT_ROUNDOFF)
    least = 0.0 if y is None else _bound_violation_below_by_farkas_vector(problem, y, upper, lower)
    if least > rounding:
        return LeastViolation(least, np.inf, rounding)
    best = float(np.inf)
    for point in _yield_less_violating_points(problem, upper, lower):
        if (best := min(best, point.violation)) <= rounding:
            break
    return LeastViolation(least, best, rounding)


def compute_reference_sizes_of_limits(problem: JointQP) -> tuple[Vector, Vector]:
    """Return magnitudes (N,) against which rounding errors of constraint limits are measured."""
    C = np.abs(problem.C)
    n = C.shape[1]
    m = len(C) - n
    limits = np.abs(np.stack((problem.U, problem.L)))
    limits[limits >= ENDLESS] = 0.0
    gamma = (n + 2) * UNIT_ROUNDOFF
    hollow = (gamma * C.max(axis=0, initial=0.0) >= C).all(axis=1)
    size = limits + np.where(
        hollow,
        0.0,
        C @ _compute_variable_sizes_at_nearest_limits(C[~hollow], limits[:, ~hollow], gamma),
    )
    known, bounds = limits[:, :m][:, ~hollow[:m]], limits[:, m:]
    others = known[known > 0.0] if known.any() else bounds[bounds > 0.0]
    if len(others):
        size[:, hollow] += np.median(others)
    size[~np.isfinite(np.stack((problem.U, problem.L)))] = 0.0
    return size[0], size[1]


def _compute_variable_sizes_at_nearest_limits(C: Matrix, limits: Matrix, gamma: float) -> Vector:
    """Return each variable's size (n,) at the nearest limit that involves it."""
    reach = np.zeros(C.shape[1])
    for j, column in enumerate(C.T):
        mentions = column > 0.0
        distance = limits[:, mentions] / column[mentions]
        distance = np.sort(distance[distance > 0.0])
        if len(distance):
            median = 0.5 * (distance[(len(distance) - 1) // 2] + distance[len(distance) // 2])
            reach[j] = distance[distance.searchsorted(gamma * median, side="right")]
    return reach


def _bound_violation_below_by_farkas_vector(
    problem: JointQP, y: Vector, upper: Vector, lower: Vector
) -> float:
    """Return a lower bound of the least relative constraint violation from a Farkas vector y."""
    rows, weights = _select_rows_with_exact_weights(problem, y)
    positive = weights.entry_signs() > 0
    limits = np.where(positive, problem.U[rows], problem.L[rows])
    size = np.where(positive, upper[rows], lower[rows])
    total = float(np.abs(weights.round_to_floats()) @ size) * OUTWARD
    short = -float((weights * Dyadic.from_floats(limits)).exact_sum().round_to_floats())
    return short / total / OUTWARD if short > 0.0 and total > 0.0 else 0.0


def _select_rows_with_exact_weights(problem: JointQP, y: Vector) -> tuple[Indices, Dyadic]:
    """Return the constraint rows with weight in a Farkas vector, and their exact weights."""
    m = len(problem.L) - len(problem.q)
    used = np.flatnonzero(y)
    if len(used) == 1 and problem.L[used[0]] > problem.U[used[0]]:
        # It stands for both limits of a row at once.
        return np.repeat(used, 2), Dyadic.from_floats(np.array([1.0, -1.0]))
    own = Dyadic.from_floats(y[:m])
    box = -(Dyadic.from_floats(problem.C[:m].T) @ own)
    low = min(box.exponent, own.exponent)
    whole = np.concatenate((own.integers_at_exponent(low), box.integers_at_exponent(low)))
    rows = np.flatnonzero(whole != 0)
    return rows, Dyadic(whole[rows], low)


def find_farkas_vector_by_magnified_lps(qp: QuadraticProgram) -> tuple[Vector, Vector] | None:
    """Find a Farkas vector (y, y_box) by linear programs on magnified residuals, or return None."""
    problem = JointQP.from_qp(qp)
    upper, lower = compute_reference_sizes_of_limits(problem)
    for point in _yield_less_violating_points(problem, upper, lower):
        if point.violation == 0.0:
            return None
        farkas = find_farkas_vector_near_candidate(qp, point.y)
        if farkas is not None:
            return farkas
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _PointViolation:
    """Largest constraint violation of a point, rounded up, and multipliers y (N,) there."""

    violation: float
    y: Vector


def _yield_less_violating_points(
    problem: JointQP, upper: Vector, lower: Vector
) -> Iterator[_PointViolation]:
    """Yield multipliers and violations of points that violate the limits less and less.

    Linear programs on the exact residuals of the point before, magnified (Gleixner, Steffy and
    Wolter, Iterative refinement for linear programming, INFORMS J. Computing 28, 2016).
    """
    above, below = np.isfinite(problem.U), np.isfinite(problem.L)
    rows = np.concatenate((np.flatnonzero(above), np.flatnonzero(below)))
    turn = np.where(np.arange(len(rows)) < above.sum(), 1.0, -1.0)
    G = turn[:, np.newaxis] * problem.C[rows]
    exact = Dyadic.from_floats(G)
    limits = Dyadic.from_floats(np.concatenate((problem.U[above], -problem.L[below])))
    size = np.concatenate((upper[above], lower[below]))
    z = Dyadic.from_floats(np.zeros(len(problem.q)))
    magnified = 1.0 / max(float(size.max(initial=0.0)), UNDERFLOW)
    slack = limits
    for _ in range(ROUNDS):
        step = _solve_lp_for_step_and_multipliers(G, slack.round_to_floats() * magnified, size)
        if step is None:
            return
        z = z + Dyadic.from_floats(step[0] / magnified)
        slack = limits - exact @ z
        violation = _compute_largest_relative_violation(slack, size)
        y = np.zeros(len(problem.L))
        np.add.at(y, rows, turn * step[1])
        yield _PointViolation(violation, y)
        magnified *= GAIN


def _compute_largest_relative_violation(slack: Dyadic, size: Vector) -> float:
    """Return the largest violation relative to the limits' sizes, rounded up."""
    violation = np.maximum(-slack.round_to_floats(), 0.0) * OUTWARD
    bad = violation > 0.0
    if (size[bad] == 0.0).any():
        return float(np.inf)
    return float((violation[bad] / size[bad]).max(initial=0.0)) * OUTWARD


def _solve_lp_for_step_and_multipliers(
    G: Matrix, slack: Vector, size: Vector
) -> tuple[Vector, Vector] | None:
    """Find the step to least constraint violation, and its multipliers, by a scaled-up LP."""
    near = slack < ENDLESS / GAIN
    A = np.column_stack((G, -size))[near]
    # Columns and rows in units of their largest numbers: the library's tolerance is absolute.
    unit = np.maximum(np.abs(A).max(axis=0, initial=0.0), UNDERFLOW)
    A /= unit
    scale = np.maximum(np.abs(A).max(axis=1, initial=0.0), UNDERFLOW)
    n = G.shape[1]
    tolerances: Any = dict.fromkeys(
        ("primal_feasibility_tolerance", "dual_feasibility_tolerance"), 1e-10
    )
    bounds = [(None, None)] * n + [(0.0, None)]
    scaled = A / scale[:, np.newaxis], slack[near] / scale
    answer = linprog(np.eye(n + 1)[n], *scaled, bounds=bounds, options=tolerances)
    if answer.x is None:
        return None
    y = np.zeros(len(slack))
    y[near] = -answer.ineqlin.marginals / scale
    return np.asarray(answer.x[:n] / unit[:n], dtype=np.float64), y
