"""Terminal cost: the cost of the infinite horizon beyond the last predicted step.

    S = AᵀSA − AᵀSB (R + BᵀSB)⁻¹ BᵀSA + CᵀQC                   (discrete algebraic Riccati equation)
    J ← J + ½ (x(N_p) − Cᵀy_d)ᵀ W (x(N_p) − Cᵀy_d),   W = S − CᵀQC
    x(N_p) = A^{N_p} x(k) + Γ ΔU,   Γ_j = A^{N_p−1−j} B

Eq. 17 already counts Q at step N_p, hence W and not S: with W and N_c = N_p the unconstrained law
is the linear-quadratic regulator at any horizon (Rawlings, Mayne & Diehl 2017, section 1.3).
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.model import StateSpace


@dataclass(frozen=True, eq=False)
class TerminalCost:
    """Quadratic cost of the state at the end of the prediction horizon, in SI units."""

    W: Matrix
    A_N: Matrix
    Gamma: Matrix
    C: Matrix

    @property
    def hessian_part(self) -> Matrix:
        """Part (n, n) of the condensed Hessian due to the terminal cost, exactly symmetric."""
        E = self.Gamma.T @ self.W @ self.Gamma
        return 0.5 * (E + E.T)

    @property
    def state_to_gradient_part(self) -> Matrix:
        """Part (n, n_x) due to the terminal cost in the map from the state to the QP gradient."""
        return self.Gamma.T @ self.W @ self.A_N

    @property
    def reference_to_gradient_part(self) -> Matrix:
        """Part (n, n_y) due to the terminal cost in the map from last reference to gradient."""
        return -self.Gamma.T @ self.W @ self.C.T

    def cost_at_zero_increments(self, x: Vector, y_d: Vector) -> float:
        """Return the terminal cost at zero increments, for the last reference y_d (n_y,)."""
        away = self.A_N @ x - self.C.T @ y_d
        return 0.5 * float(away @ self.W @ away)


def solve_discrete_riccati_of_model(
    model: StateSpace, Q: Matrix, R: Matrix, du_max: Vector
) -> Matrix:
    """Return the solution S (n_x, n_x) of the discrete Riccati equation; InputError if none."""
    # In N and N·m the entries of B and R lie up to fourteen decades from those of A and Q.
    A, B, R = model.A, model.B * du_max, R * du_max * du_max[:, np.newaxis]
    reason = "the regulator leaves a mode that does not decay"
    try:
        S = scipy.linalg.solve_discrete_are(A, B, model.C.T @ Q @ model.C, R)
        K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
        # A mode that no input steers can come back as a solution all the same.
        stable = np.abs(np.linalg.eigvals(A - B @ K)).max() < 1.0 - 1e-9
    except np.linalg.LinAlgError as error:
        stable, reason = False, str(error)
    if not stable:
        allowed = 'a model that its inputs stabilise and its weights see, or "none"'
        raise InputError("ControlProblem", "terminal", f"riccati: {reason}", allowed)
    return np.asarray(S, dtype=np.float64)


def build_terminal_cost(
    model: StateSpace, Q: Matrix, R: Matrix, du_max: Vector, N_p: int, N_c: int
) -> TerminalCost:
    """Return the terminal cost that extends an MPC of horizons N_p, N_c to an infinite horizon."""
    n_u = model.n_u
    Gamma = np.empty((model.n_x, N_c * n_u))
    reached = np.linalg.matrix_power(model.A, N_p - N_c) @ model.B
    for j in range(N_c - 1, -1, -1):
        Gamma[:, j * n_u : (j + 1) * n_u] = reached
        reached = model.A @ reached
    W = solve_discrete_riccati_of_model(model, Q, R, du_max) - model.C.T @ Q @ model.C
    A_N = np.linalg.matrix_power(model.A, N_p)
    return TerminalCost(0.5 * (W + W.T), A_N, Gamma, model.C)
