"""The linear certificate: the optimum of a QP whose active set is beyond doubt.

With K_W x = [−q; b_W], x = [z; λ], known to within ±e: if every λ_i has the sign of its limit and
every inactive slack exceeds its own error, (z_W, λ_W) satisfies the optimality conditions with
strict complementarity. For convex P it is then a minimiser, and the only one: a second one would
differ by a direction in the null space of C_W on which P vanishes, and K_W is non-singular.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix
from dpbench.qp.referee.joint import JointQP, Proof
from dpbench.qp.referee.kkt import OUTWARD, UNIT, KKTSystem, gamma


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
