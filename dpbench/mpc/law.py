"""The unconstrained law and its relation to the constrained one (paper eq. 26-36).

    ΔU = E⁻¹ Φᵀ Q̄ (D y_d − F x)                                     (eq. 27)
    Δu(k) = K_y y_d − K_mpc x,   K = [I 0 … 0]                        (eq. 33)
    x(k+1) = (A − B K_mpc) x(k) + B K_y y_d                           (eq. 34-35)
    Δu(k) = K_y y_d − K_mpc x − K K0,   K0 = E⁻¹ M_actᵀ λ_act         (eq. 36)

Eq. 36 in the paper lacks the selector K in front of K0, without which the sizes do not fit
(K0 has N_c·n_u entries, Δu has n_u), and refers to an equation 38 that does not exist.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.condense import CondensedMatrices, ControlProblem, condense_mpc_matrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import StateSpace


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains K_y (n_u, n_y) and K_mpc = [K_x K_y] (n_u, n_x) of the unconstrained MPC law.

    K_u (n_u, n_u) adds − K_u u(k−1) to the law where the force itself is weighed; else None.
    """

    K_y: Matrix
    K_mpc: Matrix
    K_u: Matrix | None = None


def compute_unconstrained_increments(matrices: CondensedMatrices, x: Vector, Y_d: Vector) -> Vector:
    """Return the increments ΔU (n,) that minimise the cost without constraints (eq. 27), in SI."""
    return -scipy.linalg.solve(matrices.E, matrices.F_x @ x + matrices.F_y @ Y_d, assume_a="pos")


def compute_state_feedback_gains(
    problem: ControlProblem, matrices: CondensedMatrices | None = None
) -> Gains:
    """Return the state-feedback gains of the unconstrained MPC law (eq. 33)."""
    matrices = condense_mpc_matrices(problem) if matrices is None else matrices
    n_u, n_y, n_x = problem.model.n_u, problem.model.n_y, problem.model.n_x
    slopes = np.hstack([-matrices.F_held, matrices.F_x, matrices.F_u])
    first = scipy.linalg.solve(matrices.E, slopes, assume_a="pos")[:n_u]
    K_u = None if problem.W is None else first[:, n_y + n_x :]
    return Gains(K_y=first[:, :n_y], K_mpc=first[:, n_y : n_y + n_x], K_u=K_u)


class UnconstrainedLaw:
    """Unconstrained MPC law, a linear state feedback that gives the first move Δu (n_u,)."""

    def __init__(self, builder: CondensedQP) -> None:
        self._builder = builder
        self._known: tuple[CondensedMatrices, Gains] | None = None

    def __call__(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return the unconstrained move Δu (n_u,) at state x, reference y_ref and input u(k−1)."""
        matrices = self._builder.matrices
        if self._known is None or self._known[0] is not matrices:
            self._known = matrices, compute_state_feedback_gains(self._builder.control, matrices)
        law = self._known[1]
        move: Vector = law.K_y @ y_ref - law.K_mpc @ x
        return move if law.K_u is None else move - law.K_u @ u_prev


def build_closed_loop_matrix(model: StateSpace, law: Gains) -> Matrix:
    """Return the closed-loop matrix A − B K_mpc (n_x, n_x) (eq. 34)."""
    return model.A - model.B @ law.K_mpc


def compute_closed_loop_eigenvalues(model: StateSpace, law: Gains) -> np.ndarray:
    """Return the eigenvalues of the closed loop (eq. 35), largest modulus first."""
    roots = np.linalg.eigvals(build_closed_loop_matrix(model, law))
    return roots[np.argsort(-np.abs(roots), kind="stable")]
