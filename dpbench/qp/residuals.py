"""Residuals of an answer: what the referee measures without knowing the optimum.

    primal          = max(0, max(l − Az, Az − u, lb − z, z − ub))
    dual            = ‖r‖_∞,  r = Pz + q + Aᵀy + y_box
    complementarity = max_i |y_i|·|slack_i| towards the limit that the sign of y_i names
    gap             = Σ_i |y_i|·|slack_i| + |zᵀr|

The gap is an upper bound of |primal − dual objective| (the identity is p − d = Σ y⁺(u − Az) +
Σ y⁻(Az − l) + box terms + zᵀr), summed without cancellation, hence never negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isnan

import numpy as np
from scipy.optimize import nnls

from dpbench.arrays import Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Solution

OPPOSITE = 1e-6
"""How much nearer the other limit must be before a multiplier counts as on the wrong side: below
it the two limits of an equality-like row cannot be told apart by a solver."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """How far an answer is from satisfying the optimality conditions, in the units of its QP."""

    primal: float
    dual: float
    complementarity: float
    gap: float


_NOTHING = Residuals(inf, inf, inf, inf)


def residuals(qp: QuadraticProgram, solution: Solution) -> Residuals:
    """The residuals of `solution`; its status is not looked at.

    A multiplier whose sign names an infinite limit, or the far side of a row that is nearer its
    other limit, is an error of full size: its slack counts as at least 1. NaN or Inf in z makes
    everything inf; in the multipliers, everything but `primal`.
    """
    z, y, y_box = solution.z, solution.y, solution.y_box
    with np.errstate(all="ignore"):
        # A sum is finite only if every term is (or it overflows: then the iterate is useless too).
        if not abs(z.sum()) < inf:
            return _NOTHING
        value = np.concatenate((qp.A @ z, z))
        lower, upper = qp.limits()
        to_upper, to_lower = upper - value, value - lower
        worst = np.minimum(to_upper, to_lower).min()
        primal = 0.0 if worst >= 0.0 else _number(-worst)
        multiplier = np.concatenate((y, y_box))
        if not abs(multiplier.sum()) < inf:
            return Residuals(primal, inf, inf, inf)
        r = qp.P @ z
        r += qp.q
        r += y @ qp.A
        r += y_box
        size = np.abs(multiplier)
        at_upper = multiplier > 0.0
        named = np.abs(np.where(at_upper, to_upper, to_lower))
        other = np.abs(np.where(at_upper, to_lower, to_upper))
        wrong = named > other + OPPOSITE
        named[named == inf] = 1.0
        product = size * np.where(wrong, np.maximum(named, 1.0), named)
        # A row free on both sides names an infinite limit by any sign: inf > inf is False above,
        # and the replaced slack of 1 makes it full size.
        return Residuals(
            primal,
            _number(np.abs(r).max()),
            _number(product.max()),
            _number(product.sum() + abs(z @ r)),
        )


def _number(value: float) -> float:
    """The value as a float, with NaN as the error it is."""
    return inf if isnan(value) else float(value)


def best_multipliers(qp: QuadraticProgram, z: Vector, tol: float) -> tuple[Vector, Vector]:
    """The multipliers that explain `z` best, for answers that come without any.

    Non-negative least squares of Pz + q + Gᵀλ over the limits G that z meets to within
    tol·(1 + |limit|); a row that meets both of its limits may have either sign.

    Returns
    -------
    y (m,), y_box (n,) : zero on rows z does not touch; NaN where z is not finite.
    """
    n, m = qp.n, qp.m
    if not np.isfinite(z).all():
        return np.full(m, np.nan), np.full(n, np.nan)
    C = np.vstack((qp.A, np.eye(n)))
    value = C @ z
    multiplier = np.zeros(m + n)
    lower, upper = qp.limits()
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


TRUE_TOL = 1e-3
"""The tolerance at which an answer is called true, where no other is named."""
PLAN_TOL_FACTOR = 10.0
"""The distance of a plan to the optimum may be so many times the tolerance of its residuals."""


def is_true(
    qp: QuadraticProgram, residuals: Residuals, error_plan: float, tol: float = TRUE_TOL
) -> bool:
    """Whether an answer is true, whatever its solver claims.

    primal ≤ tol, dual ≤ tol·(1 + ‖q‖_∞) and error_plan ≤ 10·tol, all in scaled units; NaN in any
    of them is not true.
    """
    return bool(
        residuals.primal <= tol
        and residuals.dual <= tol * (1.0 + np.abs(qp.q).max())
        and error_plan <= PLAN_TOL_FACTOR * tol
    )
