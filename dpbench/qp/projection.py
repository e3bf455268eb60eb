"""A strictly convex QP as the projection of a point onto a polyhedron, solved by an active set.

With P = L Lᵀ, x = Lᵀz and J = L⁻¹Cᵀ, minimising ½ zᵀPz + qᵀz subject to lower ≤ C z ≤ upper is to
project x0 = −L⁻¹q onto lower ≤ Jᵀx ≤ upper. The columns of J are scaled to unit length, which makes
the method independent of the units of z and of the rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix, Vector
from dpbench.qp.dual_active_set import CONTRADICTION, DualActiveSet, Outcome

# A guard against rounding only: the method ends by itself, usually within n + m iterations.
ITERATIONS_PER_ROW = 5


@dataclass(frozen=True, eq=False)
class Projection:
    """The constant part of the problem: L (n, n), scaled J (n, N), scale (N,)."""

    L: Matrix
    J: Matrix
    scale: Vector

    @classmethod
    def of(cls, P: Matrix, C: Matrix) -> Projection:
        """For P (n, n) and rows C (N, n); LinAlgError if P is not positive definite."""
        L = np.linalg.cholesky(0.5 * (P + P.T)).astype(np.float64)
        J = scipy.linalg.solve_triangular(L, C.T, lower=True)
        length = np.linalg.norm(J, axis=0)
        scale = np.ones(length.size)
        np.divide(1.0, length, out=scale, where=length > 0.0)
        return cls(L, J * scale, scale)

    def solve(
        self,
        q: Vector,
        lower: Vector,
        upper: Vector,
        *,
        start: Vector | None = None,
        contradiction: float = CONTRADICTION,
    ) -> Outcome:
        """Where the dual active-set method ends; multipliers are those of the unscaled rows.

        start : (N,) signs of the rows to begin with, as in `DualActiveSet.run`.
        """
        x0 = -np.linalg.solve(self.L, q).astype(np.float64)
        limit = ITERATIONS_PER_ROW * self.scale.size
        low, high = lower * self.scale, upper * self.scale
        method = DualActiveSet(self.J, x0, low, high, limit=limit, contradiction=contradiction)
        outcome = method.run(start)
        return replace(outcome, multipliers=outcome.multipliers * self.scale)
