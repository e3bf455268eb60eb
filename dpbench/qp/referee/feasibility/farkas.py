"""Certificates that a QP has no feasible point, or no lower bound; decided exactly.

    Farkas:     Aᵀy + y_box = 0,  Σ u y⁺ − Σ l y⁻ + Σ ub y_box⁺ − Σ lb y_box⁻ < 0,
                y± = max(±y, 0), a positive part only on finite upper limits, a negative one only
                on finite lower limits
    unbounded:  Pd = 0, qᵀd < 0, d in the recession cone of the limits

A feasible z would give 0 = zᵀ(Aᵀy + y_box) ≤ the sum on the left of "< 0".
"""

from collections.abc import Iterator
from fractions import Fraction
from itertools import chain
from math import lcm
from typing import Any

import numpy as np
from scipy.optimize import linprog

from dpbench.arrays import Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.optimum import JointQP

CONSISTENT = 1e-6  # relative error of Aᵀy + y_box = 0 in a claimed vector
DENOMINATORS = (1, 12, 60, 1000)  # of fractions near a vector, tried in turn


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
