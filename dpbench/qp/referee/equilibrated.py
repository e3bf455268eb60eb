"""Equilibration of a QP by powers of two: the same problem to the last bit.

    z = D z',  P' = c D P D,  q' = c D q,  A' = R A D,  [l'; lb'] = [R l; D⁻¹ lb],  likewise u

D, R and c come from Ruiz's equilibration of [P Aᵀ; A 0] (A scaling algorithm to equilibrate both
rows and columns norms in matrices, RAL-TR-2001-034), rounded to powers of two.
"""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.optimum import JointQP

SWEEPS = 10
RANGE = 1e250  # Numbers beyond it, or below its inverse, could leave float64 where they are scaled


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """Equilibration factors D (n,), R (N,) and c, powers of two, of a QP's matrices P and C."""

    D: Vector
    R: Vector
    cost: float

    @classmethod
    def compute_ruiz_scales(cls, P: Matrix, C: Matrix) -> "Scales":
        """Compute the equilibration factors of P (n, n) and C (N, n) by Ruiz's method."""
        n = len(P)
        A = np.abs(C[:-n])
        D, R = np.ones(n), np.ones(len(A))
        for _ in range(SWEEPS):
            rows, cost = A * R[:, np.newaxis] * D, np.abs(P) * D[:, np.newaxis] * D
            D = D / _take_square_roots_or_one_at_zero(
                np.maximum(rows.max(axis=0, initial=0.0), cost.max(axis=0, initial=0.0))
            )
            R = R / _take_square_roots_or_one_at_zero(rows.max(axis=1, initial=0.0))
        D, R = _round_to_powers_of_two(D), _round_to_powers_of_two(R)
        largest = float((np.abs(P) * D[:, np.newaxis] * D).max(initial=0.0))
        cost_scale = float(_round_to_powers_of_two(np.array(1.0 / (largest or 1.0))))
        return cls(D, np.concatenate((R, 1.0 / D)), cost_scale)

    def scale_cost_matrix(self, P: Matrix) -> Matrix:
        """Return the equilibrated cost matrix c D P D (n, n)."""
        return self.cost * P * self.D[:, np.newaxis] * self.D

    def scale_constraint_rows(self, C: Matrix) -> Matrix:
        """Return the equilibrated constraint rows R C D (N, n)."""
        return C * self.R[:, np.newaxis] * self.D

    def scale_problem(self, problem: JointQP, P: Matrix, C: Matrix) -> JointQP:
        """Return a QP with equilibrated vectors q, L and U, and the given equilibrated P and C."""
        q = self.cost * problem.q * self.D
        return JointQP(P, q, C, problem.L * self.R, problem.U * self.R)

    def unscale_multipliers(self, y: Vector) -> Vector:
        """Convert multipliers y (N,) of the equilibrated problem to those of the original."""
        return y * self.R / self.cost


def is_exact_after_power_of_two_scaling(*arrays: Matrix) -> bool:
    """Return whether all finite entries stay exact when scaled by moderate powers of two."""
    sizes = np.concatenate([np.abs(array[np.isfinite(array)]).ravel() for array in arrays])
    sizes = sizes[sizes > 0.0]
    return not len(sizes) or bool(sizes.max() < RANGE and sizes.min() > 1.0 / RANGE)


def scale_to_unit_diagonal(P: Matrix) -> Matrix:
    """Return P (n, n) scaled by powers of two to a diagonal of about 1."""
    D = _round_to_powers_of_two(1.0 / _take_square_roots_or_one_at_zero(np.diagonal(P)))
    return np.asarray(P * D[:, np.newaxis] * D, dtype=np.float64)


def _take_square_roots_or_one_at_zero(size: Vector) -> Vector:
    """Return the square roots of the sizes, 1 where a size is zero."""
    return np.sqrt(np.where(size > 0.0, size, 1.0))


def _round_to_powers_of_two(size: Vector) -> Vector:
    """Return the nearest power of two of each positive number."""
    return np.asarray(np.exp2(np.round(np.log2(size))), dtype=np.float64)
