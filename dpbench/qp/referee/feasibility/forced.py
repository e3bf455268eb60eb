"""Forcing rows: rows that leave their variables no freedom, as after a drop of an amplitude limit.

If Σ_j min(a_ij·lb_j, a_ij·ub_j) = u_i exactly, every variable of row i sits at the bound that gives
the minimum (Andersen and Andersen, Presolving in linear programming, Mathematical Programming 71,
1995); likewise the maximum and l_i. Such a problem has no interior and its multipliers are not
unique, but with those variables fixed and the row dropped it has the same feasible set and an
active set beyond doubt.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.joint import JointQP

NEAR = 1e-9
"""Relative distance within which a row is worth the exact comparison."""


def fix_forced(problem: JointQP) -> JointQP | None:
    """The same problem with forced variables fixed and forcing rows dropped; None without any.

    None too where two rows force a variable to different bounds, which is for others to refute.
    """
    n = len(problem.q)
    m = len(problem.L) - n
    A, L, U = problem.C[:m], problem.L.copy(), problem.U.copy()
    lb, ub = problem.L[m:], problem.U[m:]
    # The lower side of a row is the upper side of its negative.
    sides = ((A, U[:m]), (-A, -L[:m]))
    forcing_rows = [_forcing(rows, lb, ub, limit) for rows, limit in sides]
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


def _forcing(A: Matrix, lb: Vector, ub: Vector, u: Vector) -> NDArray[np.intp]:
    """Rows whose smallest value over the bounds is exactly their upper limit."""
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
    exact = Dyadic.of(positive[rows]) @ Dyadic.of(lb) + Dyadic.of(negative[rows]) @ Dyadic.of(ub)
    forcing: NDArray[np.intp] = rows[(exact - Dyadic.of(u[rows])).signs() == 0]
    return forcing
