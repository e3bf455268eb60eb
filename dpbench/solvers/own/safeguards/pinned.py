"""Whether rows with equal limits that depend on one another do so to the last bit.

A row that is a combination of others but for rounding is, taken for exact, independent of them: it
asks for one point more, and rounding decides which. One that is a combination exactly, but has
another limit, leaves no point at all. No answer computed in floating point from such rows is their
optimum, however well it meets the optimality conditions.

    rest = r · basis   in long double
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix
from dpbench.qp.program import QuadraticProgram

INDEPENDENT = 1e-7
"""Share of a row's length that has to be left beside the others."""
ROUNDING = float(np.finfo(np.longdouble).eps)
"""Of each term of a combination: far less than rounding to double leaves."""
ROUNDS = 4
"""Of refinement of r; each gains the digits that a condition of 1 / `INDEPENDENT` has left."""


def determined(qp: QuadraticProgram) -> bool:
    """Whether the rows of [A; I] with equal limits are independent, or exactly redundant.

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
    return _redundant(both[order[:rank]], both[order[rank:]])


def apart(rows: Matrix, share: float) -> bool:
    """Whether no row is a combination of others, but for that share of its length or less."""
    rows = rows[rows.any(axis=1)]
    if len(rows) > rows.shape[1]:
        return False
    R = scipy.linalg.qr((rows.T / np.linalg.norm(rows, axis=1)), mode="r", pivoting=True)[0]
    return bool((np.abs(np.diagonal(R)) > share).all())


def _redundant(basis: Matrix, rest: Matrix) -> bool:
    """Whether the rows of `rest` are exact combinations of those of `basis`, limits included."""
    Q, R = np.linalg.qr(basis[:, :-1].T)
    exact, target = basis.astype(np.longdouble), rest.astype(np.longdouble)
    r = np.zeros((len(rest), len(basis)), dtype=np.longdouble)
    for _ in range(ROUNDS):
        left = (target - r @ exact).astype(np.float64)[:, :-1]
        r += scipy.linalg.solve_triangular(R, Q.T @ left.T).T
    terms = np.abs(target).max(axis=1) + np.abs(r) @ np.abs(exact).max(axis=1)
    rounding = ROUNDING * (2 + len(basis)) * terms
    return bool((np.abs(target - r @ exact).max(axis=1) <= rounding).all())
