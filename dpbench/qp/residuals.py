"""Residuals of an answer, which need no optimum.

    primal          = max(0, max(l − Az, Az − u, lb − z, z − ub))
    dual            = ‖r‖_∞,  r = Pz + q + Aᵀy + y_box
    complementarity = max_i |y_i|·|slack_i| towards the limit that the sign of y_i names
    gap             = Σ_i |y_i|·|slack_i| + |zᵀr|

The gap is an upper bound of |primal − dual objective| (p − d = Σ y⁺(u − Az) + Σ y⁻(Az − l) + box
terms + zᵀr), summed without cancellation, hence never negative.
"""

from dataclasses import dataclass
from math import inf
from typing import Generic, TypeVar

import numpy as np
from scipy.optimize import nnls

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Solution

# How much nearer the other limit must be for a multiplier to count as on the wrong side: below it
# a solver cannot distinguish the two limits of an equality-like row.
OPPOSITE = 1e-6
Number = TypeVar("Number", float, Vector)


@dataclass(frozen=True, slots=True)
class Residuals(Generic[Number]):
    """Residuals of the optimality (KKT) conditions of one answer, or of K answers (K,).

    Examples
    --------
    >>> Residuals(primal=0.0, dual=1e-12, complementarity=0.0, gap=0.0).dual
    1e-12
    """

    primal: Number
    dual: Number
    complementarity: Number
    gap: Number


def residuals(qp: QuadraticProgram, solution: Solution) -> Residuals[float]:
    """Compute the KKT residuals of a solution, whatever its status.

    A multiplier whose sign names an infinite limit, or the far side of a row that is nearer its
    other limit, is an error of full size: its slack counts as at least 1. NaN or Inf in z makes
    everything inf; in the multipliers, everything but `primal`.

    Examples
    --------
    Minimise ½ z² − 2 z with z ≤ 1: z = 1 with multiplier 1. At z = 0.9 the gradient is off by 0.1.

    >>> import numpy as np
    >>> from dpbench import Status
    >>> qp = QuadraticProgram([[1]], [-2.0], lb=[-9.0], ub=[1.0])
    >>> answer = Solution(Status.SOLVED, np.array([0.9]), np.zeros(0), np.array([1.0]))
    >>> round(residuals(qp, answer).dual, 12)
    0.1
    """
    if not isinstance(solution, Solution):
        found = f"an object of type {type(solution).__name__}"
        raise TypeError(f"solution: found {found}; allowed: a Solution")
    vectors = qp.q, qp.l, qp.u, solution.z, solution.y, solution.y_box
    of_all = compute_residuals_of_many(qp, *(vector[np.newaxis] for vector in vectors))
    numbers = of_all.primal, of_all.dual, of_all.complementarity, of_all.gap
    return Residuals(*(float(number[0]) for number in numbers))


def compute_residuals_of_many(
    qp: QuadraticProgram,
    q: Matrix,
    l: Matrix,  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    u: Matrix,
    z: Matrix,
    y: Matrix,
    y_box: Matrix,
) -> Residuals[Vector]:
    """Compute the KKT residuals of K answers to K QPs with the same matrices.

    The QPs have the matrices and bounds of `qp`, and q (K, n), l, u (K, m) of their own. Sums are
    made without BLAS, so that no answer's last bits depend on the number of others.
    """
    bounds = np.broadcast_to(qp.lb, z.shape), np.broadcast_to(qp.ub, z.shape)
    with np.errstate(all="ignore"):
        value = np.concatenate((np.einsum("kn,mn->km", z, qp.A), z), axis=1)
        to_upper = np.concatenate((u, bounds[1]), axis=1) - value
        to_lower = value - np.concatenate((l, bounds[0]), axis=1)
        worst = np.minimum(to_upper, to_lower).min(axis=1)
        primal = np.where(worst >= 0.0, 0.0, -worst)
        multiplier = np.concatenate((y, y_box), axis=1)
        r = np.einsum("kn,mn->km", z, qp.P) + q + np.einsum("km,mn->kn", y, qp.A) + y_box
        at_upper = multiplier > 0.0
        named = np.abs(np.where(at_upper, to_upper, to_lower))
        other = np.abs(np.where(at_upper, to_lower, to_upper))
        wrong = named > other + OPPOSITE
        # A row free on both sides names an infinite limit by any sign: inf > inf is False above,
        # and the replaced slack of 1 makes it full size.
        named[named == inf] = 1.0
        product = np.abs(multiplier) * np.where(wrong, np.maximum(named, 1.0), named)
        gap = product.sum(axis=1) + np.abs(np.einsum("kn,kn->k", z, r))
        of_multipliers = np.abs(r).max(axis=1), product.max(axis=1), gap
        # A sum is finite only if every term is (or it overflows: then the iterate is useless too).
        no_point = ~(np.abs(z.sum(axis=1)) < inf)
        nothing = no_point | ~(np.abs(multiplier.sum(axis=1)) < inf)
    others = (_replace_nan_and_flagged_by_inf(number, nothing) for number in of_multipliers)
    return Residuals(_replace_nan_and_flagged_by_inf(primal, no_point), *others)


def _replace_nan_and_flagged_by_inf(numbers: Vector, lost: Flags) -> Vector:
    """Replace NaN, and every value where `lost` is set, by inf."""
    return np.where(lost | np.isnan(numbers), inf, numbers)


def fit_row_and_bound_multipliers(
    qp: QuadraticProgram, z: Vector, tol: float
) -> tuple[Vector, Vector]:
    """Compute multipliers y (m,) and y_box (n,) by non-negative least squares from z alone.

    Non-negative least squares of Pz + q + Gᵀλ over the limits G that z meets to within tol·(1 +
    |limit|); a row that meets both of its limits may have either sign. Multipliers are zero on
    other rows, and NaN where z is not finite.
    """
    n, m = qp.n, qp.m
    if not np.isfinite(z).all():
        return np.full(m, np.nan), np.full(n, np.nan)
    C = np.vstack((qp.A, np.eye(n)))
    value = C @ z
    multiplier = np.zeros(m + n)
    lower, upper = qp.stack_row_and_bound_limits()
    rows, signs = [], []
    for limit, sign in ((upper, 1.0), (lower, -1.0)):
        met = np.flatnonzero(sign * (value - limit) >= -tol * (1.0 + np.abs(limit)))
        met = met[np.isfinite(limit[met])]
        rows.append(met)
        signs.append(np.full(len(met), sign))
    row, sign_of = np.concatenate(rows), np.concatenate(signs)
    if len(row):
        lam, _ = nnls((sign_of[:, np.newaxis] * C[row]).T, -(qp.P @ z + qp.q))
        np.add.at(multiplier, row, sign_of * lam)
    return multiplier[:m], multiplier[m:]


TRUE_TOL = 1e-3  # The tolerance at which an answer is called true, where no other is named
PLAN_TOL_FACTOR = 10.0  # allowed distance of a plan to the optimum, in tolerances of residuals


def are_answers_correct(
    q: Matrix, residuals: Residuals[Vector], error_plan: Vector, tol: float
) -> Flags:
    """Return for K answers to QPs of gradients q (K, n) whether each is correct: (K,).

    primal ≤ tol, dual ≤ tol·(1 + ‖q‖_∞) and error_plan ≤ 10·tol, all in scaled units; not for NaN.
    """
    true: Flags = (
        (residuals.primal <= tol)
        & (residuals.dual <= tol * (1.0 + np.abs(q).max(axis=1)))
        & (error_plan <= PLAN_TOL_FACTOR * tol)
    )
    return true
