"""The condensed QP of the paper (eq. 16-25) as constant matrices and one affine map of θ.

    Y = F x(k) + Φ ΔU,   F = [C A; …; C A^{N_p}],   Φ_ij = h_{i−j},   h_t = C A^t B  (eq. 13-15)
    J = ½ (Y_d − Y)ᵀ Q̄ (Y_d − Y) + ½ ΔUᵀ R̄ ΔU                               (eq. 17)
      = ½ ΔUᵀ E ΔU + ΔUᵀ F_k + J0,   E = Φᵀ Q̄ Φ + R̄                          (eq. 24)
    F_k = −Φᵀ Q̄ (D y_d − F x)                                                 (eq. 24)
    U_min ≤ C1 u(k−1) + C2 ΔU ≤ U_max,   −ΔU_max ≤ ΔU ≤ ΔU_max                 (eq. 18-21)

With z = ΔU/Δu_max (`units="scaled"`) the rows are divided by Δu_max too, so that A = C2, lb = −1,
ub = 1 and the cost keeps its value; `units="si"` leaves everything in N and N·m. In both,
[q; l; u] is an affine map of θ = [x; y_ref; u_prev], so a step is one matrix-vector product.

A controller that commands thrusters has their forces f for u, the model's B T_e for B, and

    J ← J + ½ Σ f_iᵀ W f_i over the N_c moves,   f = C1 f(k−1) + C2 ΔF:
    E ← E + C2ᵀ W̄ C2,   F_k ← F_k + C2ᵀ W̄ C1 f(k−1)
    u_min ≤ G f_i ≤ u_max,   the sides of their polygons (`thruster_rows.py`)

The terminal cost is that of the infinite horizon beyond the last predicted step:

    S = AᵀSA − AᵀSB (R + BᵀSB)⁻¹ BᵀSA + CᵀQC                   (discrete algebraic Riccati equation)
    J ← J + ½ (x(N_p) − Cᵀy_d)ᵀ W (x(N_p) − Cᵀy_d),   W = S − CᵀQC
    x(N_p) = A^{N_p} x(k) + Γ ΔU,   Γ_j = A^{N_p−1−j} B

Eq. 17 already counts Q at step N_p, hence W and not S: with W and N_c = N_p the unconstrained law
is the linear-quadratic regulator at any horizon (Rawlings, Mayne & Diehl 2017, section 1.3).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.linalg
from numpy.lib.stride_tricks import as_strided

from dpbench.arrays import Floats, Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.kernels import (
    build_affine_map_from_blocks,
    condense_model_and_weights,
    write_rows_of_summed_increments,
)
from dpbench.mpc.model import StateSpace, relinearise_model_at_turned_heading
from dpbench.mpc.thruster_rows import Limits, ThrusterRows
from dpbench.qp.program import require_shapes_and_make_contiguous

UnitSystem = Literal["scaled", "si"]
Terminal = Literal["none", "riccati"]


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
    reason = "a mode of the closed loop does not decay"
    try:
        S = scipy.linalg.solve_discrete_are(A, B, model.C.T @ Q @ model.C, R)
        K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
        # A mode that no input steers can come back as a solution all the same.
        stable = np.abs(np.linalg.eigvals(A - B @ K)).max() < 1.0 - 1e-9
    except np.linalg.LinAlgError as error:
        stable, reason = False, str(error)
    if not stable:
        found = f'"riccati" ({reason.rstrip(".")})'
        allowed = 'a stabilisable model that is detectable through its weights, or "none"'
        raise InputError("ControlProblem", "terminal", found, allowed)
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


@dataclass(frozen=True, eq=False)
class ControlProblem:
    """Model, horizons, weights and limits of a model predictive controller, in SI units.

    model : the incremental model (eq. 11).
    N_p, N_c : prediction and control horizon, 1 ≤ N_c ≤ N_p.
    Q : (n_y, n_y) output weight; R : (n_u, n_u) weight of the increments; the same at all steps.
    u_min, u_max : (r,) amplitude limits of G u, r = n_u and G = I but for thrusters;
        du_max : (n_u,) largest increment per sample.
    thrusters : the rows G whose limits u_min, u_max are, where u are forces of thrusters.
    W : (n_u, n_u) weight of u itself over the planned moves; None for none, as in the paper.
    terminal : "none", the paper's, or "riccati", the cost of the infinite horizon at its end.
    G : (r, n_u) rows of the amplitude limits; limits : those of G u while nothing has failed.
    row_max : (r,) the change of G u by a maximum increment along each row: its unit.
    """

    model: StateSpace
    N_p: int
    N_c: int
    Q: Matrix
    R: Matrix
    u_min: Vector
    u_max: Vector
    du_max: Vector
    terminal: Terminal = "none"
    thrusters: ThrusterRows | None = None
    W: Matrix | None = None
    G: Matrix = field(init=False)
    row_max: Vector = field(init=False)
    limits: Limits = field(init=False)

    def __post_init__(self) -> None:
        n_u, n_y = self.model.n_u, self.model.n_y
        r = n_u if self.thrusters is None else len(self.thrusters.low)
        shapes: dict[str, tuple[int, ...]] = {"u_min": (r,), "u_max": (r,), "du_max": (n_u,)}
        shapes |= {"Q": (n_y, n_y), "R": (n_u, n_u)}
        if self.W is not None:
            shapes["W"] = (n_u, n_u)
        require_shapes_and_make_contiguous(self, shapes)
        G, row_max, limits = np.eye(n_u), self.du_max, Limits(self.u_min, self.u_max)
        if (rows := self.thrusters) is not None:
            G, row_max, limits = rows.G, rows.largest_row_changes_per_step(self.du_max), rows.intact
        for name, value in {"G": G, "row_max": row_max, "limits": limits}.items():
            object.__setattr__(self, name, value)
        if not 1 <= self.N_c <= self.N_p:
            horizons = f"N_c = {self.N_c}, N_p = {self.N_p}"
            raise InputError("ControlProblem", "N_c", horizons, "1 ≤ N_c ≤ N_p")
        if self.terminal not in ("none", "riccati"):
            allowed = '"none" or "riccati"'
            raise InputError("ControlProblem", "terminal", repr(self.terminal), allowed)

    @property
    def horizons_by_name(self) -> dict[str, int]:
        """Prediction horizon N_p and control horizon N_c, by name."""
        return {"N_p": self.N_p, "N_c": self.N_c}

    def relinearise_at_turned_heading(self, turn_rad: float) -> "ControlProblem":
        """Return the MPC problem with its model re-linearised, the heading turned by `turn_rad`."""
        return replace(self, model=relinearise_model_at_turned_heading(self.model, turn_rad))


def build_block_toeplitz_matrix(h: Floats, N_c: int) -> Matrix:
    """Return the block-Toeplitz prediction matrix Φ (N_p·n_y, N_c·n_u) of Markov parameters h."""
    N_p, n_y, n_u = h.shape
    padded = np.zeros((N_c - 1 + N_p, n_y, n_u))
    padded[N_c - 1 :] = h
    s_block, s_row, s_column = padded.strides
    strides = s_block, s_row, -s_block, s_column
    blocks = as_strided(padded[N_c - 1 :], (N_p, n_y, N_c, n_u), strides, writeable=False)
    return blocks.reshape(N_p * n_y, N_c * n_u)


def build_rows_of_summed_increments(N_c: int, G: Matrix) -> Matrix:
    """Return the matrix that maps all increments Δu to the limited values G u of each move."""
    rows = np.empty((N_c * G.shape[0], N_c * G.shape[1]))
    write_rows_of_summed_increments(G, rows)
    return rows


def scale_amplitude_limit_rows(problem: ControlProblem, units: UnitSystem) -> Matrix:
    """Return constraint rows G (r, n_u) of the input amplitude limits, in scaled or SI units."""
    if units == "si" or problem.thrusters is None:
        return problem.G
    return problem.G * problem.du_max / problem.row_max[:, np.newaxis]


@dataclass(frozen=True, eq=False)
class CondensedMatrices:
    """Constant matrices of the condensed MPC problem, in SI units.

    E (n, n), F_x (n, n_x), F_held (n, n_y) with F_k = F_x x + F_held y_d for a reference that is
    constant over the horizon; F (N_p·n_y, n_x) and the Markov parameters h (N_p, n_y, n_u) of
    eq. 15; Q (n_y, n_y); F_u (n, n_u), the part F_u u(k−1) of F_k by a weight of the force, n_u = 0
    without; `end`, the terminal cost, which E, F_x and F_held include.
    """

    E: Matrix
    F_x: Matrix
    F_held: Matrix
    F: Matrix
    h: Floats
    Q: Matrix
    F_u: Matrix
    end: TerminalCost | None = None

    @cached_property
    def Phi(self) -> Matrix:
        """Prediction matrix Φ (N_p·n_y, n) from increments to outputs (eq. 15)."""
        return build_block_toeplitz_matrix(self.h, self.E.shape[0] // self.h.shape[2])

    @cached_property
    def F_y(self) -> Matrix:
        """Map (n, N_p·n_y) from a reference that varies over the horizon to the QP gradient."""
        N_p, n_y, _ = self.h.shape
        n = self.E.shape[0]
        blocks = self.Phi.reshape(N_p, n_y, n).transpose(2, 0, 1)
        F_y = -(blocks @ self.Q).reshape(n, N_p * n_y)
        if self.end is not None:
            F_y[:, -n_y:] += self.end.reference_to_gradient_part
        return F_y


def condense_mpc_matrices(problem: ControlProblem) -> CondensedMatrices:
    """Condense the MPC problem: eliminate the states, return its constant matrices (eq. 15-24)."""
    model, Q = problem.model, problem.Q
    matrices = model.A, model.B, model.C, Q, problem.R
    E, F_x, F_held, F, h = condense_model_and_weights(*matrices, problem.N_p, problem.N_c)
    F_u = np.zeros((len(E), 0))
    if problem.W is not None:
        thrust, F_u = _hessian_and_gradient_of_input_cost(problem.W, problem.N_c)
        E = E + thrust
    if problem.terminal == "none":
        return CondensedMatrices(E, F_x, F_held, F, h, Q, F_u)
    end = build_terminal_cost(model, Q, problem.R, problem.du_max, problem.N_p, problem.N_c)
    return CondensedMatrices(
        E + end.hessian_part,
        F_x + end.state_to_gradient_part,
        F_held + end.reference_to_gradient_part,
        F,
        h,
        Q,
        F_u,
        end,
    )


def _hessian_and_gradient_of_input_cost(W: Matrix, N_c: int) -> tuple[Matrix, Matrix]:
    """Return Hessian (n, n) and gradient map (n, n_u) of the summed input cost ½ Σ uᵢᵀ W uᵢ."""
    # Move j adds to the forces of j and all that follow.
    i = np.arange(float(N_c))
    E: Matrix = np.kron(N_c - np.maximum.outer(i, i), W)
    F_u: Matrix = np.kron((N_c - i)[:, np.newaxis], W)
    return E, F_u


def build_affine_map(
    problem: ControlProblem, matrices: CondensedMatrices, units: UnitSystem
) -> Matrix:
    """Return the matrix Z that gives a step's QP vectors: [q; l; u] = Z [x; y_ref; u_prev; 1]."""
    unit, row_unit = problem.du_max, problem.row_max
    if units == "si":
        unit, row_unit = np.ones(len(unit)), np.ones(len(row_unit))
    of_theta = matrices.F_x, matrices.F_held, matrices.F_u
    limits = problem.G, problem.u_min, problem.u_max
    Z: Matrix = build_affine_map_from_blocks(*of_theta, *limits, unit, row_unit)
    return Z
