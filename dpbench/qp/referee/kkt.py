"""KKT systems of one active set with a rigorous error bound, and the linear certificate.

    K = [P  Gᵀ; G  0],   X ≈ K⁻¹,   |I − XK| d ≤ α d  with α < 1
    |K⁻¹b − x| ≤ e + α/(1−α) · max_i(e_i/d_i) · d,   e ≥ |X(b − Kx)|

Rump, Verification methods, Acta Numerica 19 (2010), section 10; rounding errors by the a priori
constants γ_k = k·u/(1 − k·u) of Higham, Accuracy and Stability, section 3.1, which hold for every
order of summation and with fused operations.

The linear certificate is for a QP whose active set is beyond doubt. With K_W x = [−q; b_W], x = [z;
λ], known to within ±e: if every λ_i has the sign of its limit and every inactive slack exceeds its
own error, (z_W, λ_W) satisfies the optimality conditions with strict complementarity. For convex P
it is then a minimiser, and the only one: a second one would differ by a direction in the null space
of C_W on which P vanishes, and K_W is non-singular.
"""

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.kernels import OUTWARD, UNDERFLOW, UNIT, prove_active_set_optimal
from dpbench.qp.referee.optimum import JointQP, Proof


def compute_rounding_error_factor(k: int) -> float:
    """Return the rounding-error factor γ_k = k·u / (1 − k·u) of k operations."""
    return k * UNIT / (1.0 - k * UNIT)


class KKTSystem:
    """KKT matrix of an active set, with an inverse verified against rounding.

    rows (w,), signs (w,) : active rows of C and their sides (+1 upper); X (n+w, n+w) : approximate
    inverse, X_T : its columns as rows; alpha : proven bound of ‖I − XK‖ in the norm weighted by
    `weight`, inf or ≥ 1 where K may be singular.
    """

    def __init__(self, P: Matrix, C: Matrix, signs: NDArray[np.int8]) -> None:
        n = P.shape[0]
        self.n, self.rows = n, np.flatnonzero(signs)
        self.signs = signs[self.rows].astype(np.float64)
        # Position of each active limit in the concatenation [U; L].
        self.limits = np.where(self.signs > 0, self.rows, self.rows + C.shape[0])
        N = n + len(self.rows)
        self.K = np.zeros((N, N))
        self.K[:n, :n] = P
        self.K[n:, :n] = C[self.rows]
        self.K[:n, n:] = C[self.rows].T
        self.weight = np.ones(N)
        self.weight[n:] = float(np.abs(P).max()) or 1.0
        self.alpha = np.inf
        self.gamma = compute_rounding_error_factor(N + 4)
        try:
            self.X = np.linalg.inv(self.K)
        except np.linalg.LinAlgError:
            return
        if not np.isfinite(self.X).all():
            return
        self.X_T = np.ascontiguousarray(self.X.T)
        defect = np.abs(np.eye(len(self.K)) - self.X @ self.K) @ self.weight
        # |X|(|K| d) in place of (|X||K|) d: a matrix product less.
        size = np.abs(self.X) @ (np.abs(self.K) @ self.weight) + self.weight
        self.alpha = float(((defect + self.gamma * size) / self.weight).max()) * OUTWARD

    @property
    def is_proven_nonsingular(self) -> bool:
        """Return whether the KKT matrix is proven non-singular."""
        return self.alpha < 0.5

    def build_right_hand_side(self, q: Vector, L: Vector, U: Vector) -> Vector:
        """Return the KKT right-hand side [−q; b_W] (n + w,), b_W the active limits."""
        return np.concatenate((-q, np.concatenate((U, L))[self.limits]))

    def bound_inverse_entrywise(self) -> Matrix:
        """Return rigorous entrywise upper bounds of |K⁻¹|."""
        X = np.abs(self.X)
        column = (X / self.weight[:, np.newaxis]).max(axis=0)
        spread = self.alpha / (1.0 - self.alpha)
        return (X + spread * np.outer(self.weight, column)) * OUTWARD


def is_proven_positive_definite(P: Matrix) -> bool:
    """Return whether P is proven positive definite, with rounding (Rump, BIT 46, theorem 2.3)."""
    n = P.shape[0]
    trace = float(np.abs(np.diagonal(P)).sum())
    margin = 2.0 * compute_rounding_error_factor(n + 3) * trace + UNDERFLOW
    try:
        np.linalg.cholesky(P - margin * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


class Geometry:
    """Constraint matrix C by columns, and a rounding factor to bound the error of slacks."""

    def __init__(self, C: Matrix) -> None:
        self.C_T = np.ascontiguousarray(C.T)
        self.gamma = compute_rounding_error_factor(C.shape[1] + 2)


def prove_optimum_by_kkt_error_bounds(
    problem: JointQP, geometry: Geometry, system: KKTSystem
) -> Proof | None:
    """Certify an optimum whose active set is beyond doubt, or return None.

    `system` must be `proven` and of the problem's matrices, P positive semidefinite and L ≤ U.
    """
    bound, x, _, y = prove_active_set_optimal(
        *(problem.q, problem.L, problem.U, geometry.C_T, geometry.gamma),
        *(system.K, system.X_T, system.weight, system.rows, system.signs),
        *(system.alpha, system.gamma),
    )
    return Proof(x[: system.n], y, bound, "linear") if bound < np.inf else None
