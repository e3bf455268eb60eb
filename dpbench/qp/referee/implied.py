"""Forcing rows, limits that are never slack, equality rows that others imply; decided exactly.

*Never slack.* Rows whose sides add up to nothing, Σ v_i s_i c_i = 0 with v_i > 0 (of either sign on
equality rows) and Σ v_i s_i limit_i = 0, are met with equality by every feasible z: their slacks
are non-negative and add up to zero. Such a problem has no interior. With these rows as equalities,
and without equality rows that are combinations of others, it has the same feasible set. The
weights come from a linear program, are rounded to fractions, and must add up exactly.

*Forcing.* If Σ_j min(a_ij·lb_j, a_ij·ub_j) = u_i exactly, as after a drop of an amplitude limit,
every variable of row i is at the bound that gives the minimum (Andersen and Andersen, Presolving in
linear programming, Mathematical Programming 71, 1995); likewise the maximum and l_i. Such a problem
has no interior and its multipliers are not unique, but with those variables fixed and the row
dropped it has the same feasible set and an active set beyond doubt.
"""

from typing import Any

import numpy as np
from scipy.optimize import linprog

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.farkas import round_to_integer_proportions
from dpbench.qp.referee.gap import select_independent_active_rows
from dpbench.qp.referee.optimum import JointQP, Signs

NEAR = 1e-9  # Relative distance within which a row is worth the exact comparison


def fix_variables_forced_to_bounds(problem: JointQP) -> JointQP | None:
    """Fix variables that a constraint row forces to bounds, and drop that row; None if none does.

    None too where two rows force a variable to different bounds, which other proofs refute.
    """
    n = len(problem.q)
    m = len(problem.L) - n
    A, L, U = problem.C[:m], problem.L.copy(), problem.U.copy()
    lb, ub = problem.L[m:], problem.U[m:]
    # The lower side of a row is the upper side of its negative.
    sides = ((A, U[:m]), (-A, -L[:m]))
    forcing_rows = [
        _find_rows_forcing_variables_to_bounds(rows, lb, ub, limit) for rows, limit in sides
    ]
    if not any(len(rows) for rows in forcing_rows):
        return None
    for (signed, _), forcing in zip(sides, forcing_rows, strict=True):
        for i in forcing:
            down, up = signed[i] > 0, signed[i] < 0
            U[m:][down] = lb[down]
            L[m:][up] = ub[up]
    if (L > U).any():
        return None
    dropped = np.concatenate(forcing_rows)
    L[dropped], U[dropped] = -np.inf, np.inf
    return JointQP(problem.P, problem.q, problem.C, L, U)


def _find_rows_forcing_variables_to_bounds(A: Matrix, lb: Vector, ub: Vector, u: Vector) -> Indices:
    """Find rows whose smallest value within the bounds equals their limit exactly."""
    positive, negative = np.maximum(A, 0.0), np.minimum(A, 0.0)
    low, high = (np.isfinite(bound) for bound in (lb, ub))
    lb, ub = np.where(low, lb, 0.0), np.where(high, ub, 0.0)
    bounded = np.isfinite(u) & ~(positive[:, ~low].any(axis=1) | negative[:, ~high].any(axis=1))
    smallest = positive @ lb + negative @ ub
    u = np.where(bounded, u, 0.0)
    rows = np.flatnonzero(
        bounded & A.any(axis=1) & (np.abs(smallest - u) <= NEAR * (1 + np.abs(u)))
    )
    if not len(rows):
        return rows
    exact = Dyadic.from_floats(positive[rows]) @ Dyadic.from_floats(lb) + Dyadic.from_floats(
        negative[rows]
    ) @ Dyadic.from_floats(ub)
    forcing: Indices = rows[(exact - Dyadic.from_floats(u[rows])).entry_signs() == 0]
    return forcing


DENOMINATOR = 1000  # Largest denominator of a weight
NEGLIGIBLE_WEIGHT = 1e-9  # Weights below it are rounding


def remove_limits_of_zero_rows(problem: JointQP) -> JointQP:
    """Return a new QP without the limits of zero rows that every z satisfies."""
    idle = ~problem.C.any(axis=1) & (problem.L <= 0.0) & (problem.U >= 0.0)
    L, U = np.where(idle, -np.inf, problem.L), np.where(idle, np.inf, problem.U)
    return JointQP(problem.P, problem.q, problem.C, L, U)


def turn_always_met_limits_into_equalities(problem: JointQP, touched: Signs) -> JointQP | None:
    """Make limits in `touched` that all feasible points meet equalities; None without proof."""
    equal = problem.L == problem.U
    rows = np.flatnonzero((touched != 0) & ~equal)
    weights = _find_weights_proving_equality(problem, rows, touched[rows], np.flatnonzero(equal))
    if weights is None:
        return None
    limits = np.where(touched > 0, problem.U, problem.L)
    L, U = problem.L.copy(), problem.U.copy()
    if weights.any():
        exact = round_to_integer_proportions(weights, DENOMINATOR)
        if exact is None or (exact * touched < 0.0)[~equal].any():
            return None
        if not _is_weighted_sum_of_rows_and_limits_zero(problem, limits, exact):
            return None
        never_slack = np.flatnonzero((exact != 0.0) & ~equal)
        L[never_slack] = U[never_slack] = limits[never_slack]
    return _drop_dependent_equality_rows(JointQP(problem.P, problem.q, problem.C, L, U))


def _find_weights_proving_equality(
    problem: JointQP, rows: Indices, side: Signs, equal: Indices
) -> Vector | None:
    """Find constraint weights (N,) by an LP that prove limits are always met with equality."""
    n, k = problem.C.shape[1], len(rows)
    G = side[:, np.newaxis] * problem.C[rows]
    E = problem.C[equal]
    cost, bounds = np.repeat([0.0, -1.0], [n, k]), [(None, None)] * n + [(0.0, 1.0)] * k
    constraints: dict[str, Any] = {}
    if k:
        constraints |= {"A_ub": np.hstack((G, np.eye(k))), "b_ub": np.zeros(k)}
    if len(E):
        constraints |= {"A_eq": np.hstack((E, np.zeros((len(E), k)))), "b_eq": np.zeros(len(E))}
    answer = linprog(cost, bounds=bounds, **constraints)
    if answer.x is None:
        return None
    weights = np.zeros(len(problem.L))
    weights[rows] = -side * answer.ineqlin.marginals if k else 0.0
    weights[equal] = -answer.eqlin.marginals if len(E) else 0.0
    weights[np.abs(weights) < NEGLIGIBLE_WEIGHT] = 0.0
    return weights


def _is_weighted_sum_of_rows_and_limits_zero(
    problem: JointQP, limits: Vector, weights: Vector
) -> bool:
    """Return whether weighted rows and weighted limits each sum to zero, in exact arithmetic."""
    used = np.flatnonzero(weights)
    exact = Dyadic.from_floats(weights[used])
    if (Dyadic.from_floats(problem.C[used].T) @ exact).entry_signs().any():
        return False
    return not (Dyadic.from_floats(limits[used]) * exact).exact_sum().entry_signs().any()


def _drop_dependent_equality_rows(problem: JointQP) -> JointQP | None:
    """Drop redundant equality rows; None if a dependent row is no exact combination of the rest."""
    equal = np.where(problem.L == problem.U, 1, 0).astype(np.int8)
    basis = select_independent_active_rows(problem.C, equal, equal)
    kept, rest = np.flatnonzero(basis), np.flatnonzero(equal != basis)
    L, U = problem.L.copy(), problem.U.copy()
    for i in rest:
        shares = np.linalg.lstsq(problem.C[kept].T, problem.C[i], rcond=None)[0]
        weights = np.zeros(len(L))
        weights[kept], weights[i] = np.where(np.abs(shares) < NEGLIGIBLE_WEIGHT, 0.0, shares), -1.0
        exact = round_to_integer_proportions(weights, DENOMINATOR)
        if exact is None or not _is_weighted_sum_of_rows_and_limits_zero(problem, problem.U, exact):
            return None
        L[i], U[i] = -np.inf, np.inf
    return JointQP(problem.P, problem.q, problem.C, L, U)
