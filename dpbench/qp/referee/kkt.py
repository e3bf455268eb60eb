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

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.joint import JointQP, Proof

UNIT = float(np.finfo(np.float64).eps)
LONG_UNIT = float(np.finfo(np.longdouble).eps)
"""Twice the unit roundoffs, which leaves room; long double is at least as fine as double on every
platform, and the bounds use whatever it is."""
OUTWARD = 1.0 + 1e-11
"""Makes up for the rounding of the bounds themselves: sums of up to some 10⁴ positive terms."""
UNDERFLOW = 1e-290
"""Far above what any sum here can lose by underflow."""


def gamma(k: int, unit: float = UNIT) -> float:
    """γ_k = k·u / (1 − k·u)."""
    return k * unit / (1.0 - k * unit)


class KKTSystem:
    """The KKT matrix of the rows `signs` ≠ 0 of C, its inverse and what is proven of it.

    Attributes
    ----------
    rows (w,), signs (w,) : active rows of C and the side they are active at (+1 upper).
    X (n+w, n+w) : approximate inverse. alpha : proven bound of ‖I − XK‖ in the norm weighted by
        `weight`; inf or ≥ 1 where nothing is proven (then K may be singular).
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
        size = float(np.abs(P).max()) or 1.0
        self.weight = np.ones(N)
        self.weight[n:] = size
        self.alpha = np.inf
        self.gamma, self.long_gamma = gamma(N + 4), gamma(N + 4, LONG_UNIT)
        try:
            self.X = np.linalg.inv(self.K)
        except np.linalg.LinAlgError:
            return
        if np.isfinite(self.X).all():
            self._prove()

    def _prove(self) -> None:
        N = self.K.shape[0]
        self._K_abs, self._X_abs = np.abs(self.K), np.abs(self.X)
        self._K_long = self.K.astype(np.longdouble)
        identity = np.eye(N)
        defect = np.abs(identity - self.X @ self.K)
        defect += self.gamma * (self._X_abs @ self._K_abs + identity)
        self.alpha = float(((defect @ self.weight) / self.weight).max()) * OUTWARD

    @property
    def proven(self) -> bool:
        """Whether K is proven non-singular (and X a good inverse)."""
        return self.alpha < 0.5

    def rhs(self, q: Vector, L: Vector, U: Vector) -> Vector:
        """[−q; b_W] (n+w,), b_W the limits the rows are active at."""
        return np.concatenate((-q, np.concatenate((U, L))[self.limits]))

    def solve(self, rhs: Vector, x: Vector) -> tuple[Vector, Vector]:
        """K⁻¹ rhs and a rigorous bound of its error, both (n+w,), from an approximation x.

        Call only where `proven`. One refinement; the residual in long double.
        """
        long_rhs = rhs.astype(np.longdouble)
        x = x + self.X @ (long_rhs - self._K_long @ x).astype(np.float64)
        r = (long_rhs - self._K_long @ x).astype(np.float64)
        size = self._K_abs @ np.abs(x)
        size += np.abs(rhs)
        size *= self.long_gamma
        size += self.gamma * np.abs(r)
        size += UNDERFLOW
        e = np.abs(self.X @ r)
        e += self._X_abs @ size
        e *= OUTWARD
        spread = self.alpha / (1.0 - self.alpha) * float((e / self.weight).max())
        e += spread * OUTWARD * self.weight
        return x, e

    def inverse_bounds(self) -> Matrix:
        """Entrywise upper bounds of |K⁻¹|: |X| + α/(1−α) · d · max_j(|X_ji|/d_j)."""
        column = (self._X_abs / self.weight[:, np.newaxis]).max(axis=0)
        spread = self.alpha / (1.0 - self.alpha)
        return (self._X_abs + spread * np.outer(self.weight, column)) * OUTWARD


def positive_definite(P: Matrix) -> bool:
    """Whether P is proven positive definite: Cholesky of P − cI with a margin c against rounding.

    Rump, BIT 46 (2006), theorem 2.3: if the factorisation of P − cI runs to completion with
    c ≥ γ_{n+1}/(1−γ_{n+1})·tr(P), every eigenvalue of P is positive. False means "not proven".
    """
    n = P.shape[0]
    trace = float(np.abs(np.diagonal(P)).sum())
    margin = 2.0 * gamma(n + 3) * trace + UNDERFLOW
    try:
        np.linalg.cholesky(P - margin * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


class Geometry:
    """What bounding the slacks needs of C, once."""

    def __init__(self, C: Matrix) -> None:
        self.C, self.C_abs = C, np.abs(C)
        self.gamma = gamma(C.shape[1] + 2)


def linear_certificate(
    problem: JointQP, geometry: Geometry, system: KKTSystem, *, guess: bool
) -> Proof | None:
    """The optimum, if the active set of `system` is proven to be that of `problem`.

    Parameters
    ----------
    system : a `proven` system of the problem's matrices; P must be positive semidefinite and
        L ≤ U, which the caller has checked.
    guess : give up early where the active set is plainly another one.
    """
    L, U, rows, n = problem.L, problem.U, system.rows, system.n
    rhs = system.rhs(problem.q, L, U)
    if not np.isfinite(rhs).all():
        return None
    x = system.X @ rhs
    # An equality-like row holds its multiplier at either sign.
    free = L[rows] == U[rows]
    if guess:
        value = geometry.C @ x[:n]
        slack = np.minimum(U - value, value - L)
        slack[rows] = 0.0
        if slack.min() < 0.0 or not (free | (system.signs * x[n:] > 0.0)).all():
            return None
    x, error = system.solve(rhs, x)
    if not (free | (system.signs * x[n:] > error[n:])).all():
        return None
    z, z_error = x[:n], error[:n]
    value = geometry.C @ z
    slack = np.minimum(U - value, value - L)
    slack[rows] = np.inf
    # Rounding of C z and of the final subtraction, and what z itself is uncertain by.
    doubt = geometry.C_abs @ (z_error + geometry.gamma * np.abs(z)) + UNIT * np.abs(value)
    if not (slack > doubt * OUTWARD).all():
        return None
    y = np.zeros(len(L))
    y[rows] = x[n:]
    return Proof(z, y, float(z_error.max()), "linear")
