"""Proofs in floating point that a problem has no feasible point.

    Aᵀy + y_box = 0,   Σ u y⁺ − Σ l y⁻ + Σ ub y_box⁺ − Σ lb y_box⁻ < 0

The referee decides such proofs exactly; a solver's own data have been rounded on the way, so that
it has to say what it takes for zero.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.program import QuadraticProgram

ROUNDING = 1e-13
"""Entries of a ray below this share of its largest are rounding."""
CONSISTENT = 1e-6
"""Share of its terms below which a sum of a ray may be meant to vanish."""
PROVEN = 1e-10
"""Share of its terms to which a sum of a proof is taken to be what it is computed to be."""
FAR = 1e6
"""How many times farther than the limits of the proof are no feasible point is left, where a
variable has no bound to absorb what does not cancel."""


def cleaned(y: Vector, y_box: Vector) -> tuple[Vector, Vector]:
    """A ray without the entries that are rounding, in new memory."""
    size = ROUNDING * max(np.abs(y).max(initial=0.0), np.abs(y_box).max(initial=0.0))
    return np.where(np.abs(y) > size, y, 0.0), np.where(np.abs(y_box) > size, y_box, 0.0)


def contradicts(qp: QuadraticProgram, y: Vector, y_box: Vector) -> bool:
    """Whether (y, y_box) proves `qp` infeasible, but for rounding.

    Aᵀy + y_box vanishes to `CONSISTENT` of the terms it is the sum of. With y_box := −Aᵀy, what the
    limits allow the sum of y(Az) + y_box z to reach is negative by more than `PROVEN` of its terms,
    and by more than what entries of y_box that name no bound can add within `FAR`.
    """
    box = -(y @ qp.A)
    terms = np.abs(y) @ np.abs(qp.A) + np.abs(y_box)
    if not (np.abs(box - y_box) <= CONSISTENT * terms).all():
        return False
    unbounded = np.isinf(np.where(box > 0.0, qp.ub, qp.lb))
    ray = np.concatenate([y, np.where(unbounded, 0.0, box)])
    low, high = qp.limits()
    used = ray != 0.0
    reach = ray[used] * np.where(ray[used] > 0.0, high[used], low[used])
    left = np.abs(box[unbounded]).sum() / max(float(terms.max()), np.finfo(float).tiny)
    return bool(reach.sum() < -(PROVEN + FAR * left) * np.abs(reach).sum())
