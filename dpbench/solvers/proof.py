"""Proofs in floating point that a problem has no feasible point.

    Aᵀy + y_box = 0,   Σ u y⁺ − Σ l y⁻ + Σ ub y_box⁺ − Σ lb y_box⁻ < 0

The referee decides such proofs exactly; a solver's own data have been rounded on the way, so that
it has to say what it takes for zero.
"""

from __future__ import annotations

import numpy as np

from dpbench.qp.program import QuadraticProgram, Vector

ROUNDING = 1e-13
"""Entries of a ray below this share of its largest are rounding."""
PROVEN = 1e-10
"""Share of its terms to which a sum of a proof is taken to be what it is computed to be."""


def cleaned(y: Vector, y_box: Vector) -> tuple[Vector, Vector]:
    """A ray without the entries that are rounding, in new memory."""
    size = ROUNDING * max(np.abs(y).max(initial=0.0), np.abs(y_box).max(initial=0.0))
    return np.where(np.abs(y) > size, y, 0.0), np.where(np.abs(y_box) > size, y_box, 0.0)


def contradicts(qp: QuadraticProgram, y: Vector, y_box: Vector) -> bool:
    """Whether (y, y_box) proves `qp` infeasible, but for rounding.

    Aᵀy + y_box vanishes to `PROVEN` of the terms it is the sum of, and what the limits allow the
    sum of y(Az) + y_box z to reach is negative by more than `PROVEN` of its terms.
    """
    terms = np.abs(qp.A).T @ np.abs(y) + np.abs(y_box)
    if not (np.abs(qp.A.T @ y + y_box) <= PROVEN * terms).all():
        return False
    ray = np.concatenate([y, y_box])
    low, high = np.concatenate([qp.l, qp.lb]), np.concatenate([qp.u, qp.ub])
    used = ray != 0.0
    reach = ray[used] * np.where(ray[used] > 0.0, high[used], low[used])
    return bool(reach.sum() < -PROVEN * np.abs(reach).sum())
