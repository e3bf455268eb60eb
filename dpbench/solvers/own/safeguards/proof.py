"""Proofs in floating point that a problem has no feasible point.

    Aᵀy + y_box = 0,   Σ u y⁺ − Σ l y⁻ + Σ ub y_box⁺ − Σ lb y_box⁻ < 0

The referee decides such proofs exactly; a solver's own data have been rounded on the way, so that
it has to say what it takes for zero.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Vector
from dpbench.kernel_cache import njit
from dpbench.qp.program import QuadraticProgram

ROUNDING = 1e-13
"""Entries of a ray below this share of its largest are rounding."""
CONSISTENT = 1e-6
"""Share of its terms below which a sum of a ray may be meant to vanish."""
PROVEN = 1e-10
"""Share of its terms to which a sum of a proof is taken to be what it is computed to be."""
TINY = 2.3e-308
"""The smallest number that is not subnormal."""
FAR = 1e6
"""How many times farther than the limits of the proof are no feasible point is left, where a
variable has no bound to absorb what does not cancel."""


def contradicts(qp: QuadraticProgram, y: Vector, y_box: Vector) -> bool:
    """Whether (y, y_box) proves `qp` infeasible, but for rounding; see `is_proof`."""
    return bool(is_proof(qp.A, qp.l, qp.u, qp.lb, qp.ub, y, y_box))


@njit("void(f8[:], f8[:])", cache=True)
def clean(y, y_box):  # type: ignore[no-untyped-def] # compiled by numba
    """Take the entries of a ray that are rounding out of it."""
    most = 0.0
    for part in (y, y_box):
        for i in range(len(part)):
            most = max(most, abs(part[i]))
    for part in (y, y_box):
        for i in range(len(part)):
            part[i] = part[i] if abs(part[i]) > ROUNDING * most else 0.0


@njit("UniTuple(f8, 2)(f8[:], f8[:], f8[:])", cache=True)
def _reach(ray, low, high):  # type: ignore[no-untyped-def] # compiled by numba
    """Return the largest sum along a ray that limits allow, and the size of its terms."""
    reach, size = 0.0, 0.0
    for i in range(len(ray)):
        if ray[i] != 0.0:
            term = ray[i] * (high[i] if ray[i] > 0.0 else low[i])
            reach, size = reach + term, size + abs(term)
    return reach, size


@njit("b1(f8[:, :], f8[:], f8[:], f8[:], f8[:], f8[:], f8[:])", cache=True, error_model="numpy")
def is_proof(A, l, u, lb, ub, y, y_box):  # type: ignore[no-untyped-def] # noqa: E741 - compiled by numba; as in the program
    """Whether (y, y_box) proves that l ≤ A z ≤ u and lb ≤ z ≤ ub have no point, but for rounding.

    Aᵀy + y_box vanishes to `CONSISTENT` of the terms it is the sum of. With y_box := −Aᵀy, what the
    limits allow the sum of y(Az) + y_box z to reach is negative by more than `PROVEN` of its terms,
    and by more than what entries of y_box that name no bound can add within `FAR`.
    """
    box, terms = np.zeros(len(y_box)), np.abs(y_box)
    for i in range(len(y)):
        if y[i] != 0.0:
            for k in range(len(box)):
                box[k] -= y[i] * A[i, k]
                terms[k] += abs(y[i] * A[i, k])
    unbounded, most = 0.0, TINY
    for k in range(len(box)):
        if not abs(box[k] - y_box[k]) <= CONSISTENT * terms[k]:
            return False
        most = max(most, terms[k])
        if abs(ub[k] if box[k] > 0.0 else lb[k]) == np.inf:
            unbounded += abs(box[k])
            box[k] = 0.0
    of_rows, of_bounds = _reach(y, l, u), _reach(box, lb, ub)
    size = of_rows[1] + of_bounds[1]
    return of_rows[0] + of_bounds[0] < -(PROVEN + FAR * unbounded / most) * size
