"""The condensed QP of the paper (eq. 16-25) as constant matrices and one affine map of θ.

    Y = F x(k) + Φ ΔU,   F = [C A; …; C A^{N_p}],   Φ_ij = h_{i−j},   h_t = C A^t B  (eq. 13-15)
    J = ½ (Y_d − Y)ᵀ Q̄ (Y_d − Y) + ½ ΔUᵀ R̄ ΔU                               (eq. 17)
      = ½ ΔUᵀ E ΔU + ΔUᵀ F_k + J0,   E = Φᵀ Q̄ Φ + R̄                          (eq. 24)
    F_k = −Φᵀ Q̄ (D y_d − F x)                                                 (eq. 24)
    U_min ≤ C1 u(k−1) + C2 ΔU ≤ U_max,   −ΔU_max ≤ ΔU ≤ ΔU_max                 (eq. 18-21)

With z = ΔU/Δu_max (`units="scaled"`) the rows are divided by Δu_max too, so that A = C2, lb = −1,
ub = 1 and the cost keeps its value; `units="si"` leaves everything in N and N·m. In both,
[q; l; u] is an affine map of θ = [x; y_ref; u_prev], so a step is one matrix-vector product.
One recursion G_t = C A^t (never a matrix power) gives every block of F and of Φ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.kernels import condense_blocks, map_blocks
from dpbench.mpc.model import StateSpace, rotated
from dpbench.mpc.terminal import TerminalCost, terminal_cost
from dpbench.qp.program import shaped

UnitSystem = Literal["scaled", "si"]
Terminal = Literal["none", "riccati"]


@dataclass(frozen=True, eq=False)
class ControlProblem:
    """What the controller wants and may do, in SI units.

    Parameters
    ----------
    model : the incremental model (eq. 11).
    N_p, N_c : prediction and control horizon, 1 ≤ N_c ≤ N_p.
    Q : (n_y, n_y) output weight; R : (n_u, n_u) weight of the increments; the same at all steps.
    u_min, u_max : (n_u,) amplitude limits; du_max : (n_u,) largest increment per sample.
    terminal : "none", the paper's, or "riccati", the cost of the infinite horizon at its end.
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

    def __post_init__(self) -> None:
        n_u, n_y = self.model.n_u, self.model.n_y
        shapes: dict[str, tuple[int, ...]] = {"Q": (n_y, n_y), "R": (n_u, n_u)}
        shapes |= {"u_min": (n_u,), "u_max": (n_u,), "du_max": (n_u,)}
        for name, shape in shapes.items():
            array = shaped("ControlProblem", name, getattr(self, name), shape)
            object.__setattr__(self, name, array)
        if not 1 <= self.N_c <= self.N_p:
            horizons = f"N_c = {self.N_c}, N_p = {self.N_p}"
            raise InputError("ControlProblem", "N_c", horizons, "1 ≤ N_c ≤ N_p")
        if self.terminal not in ("none", "riccati"):
            raise InputError(
                "ControlProblem", "terminal", repr(self.terminal), '"none" or "riccati"'
            )

    def turned(self, turn_rad: float) -> ControlProblem:
        """The same problem with the ship's model linearised `turn_rad` further (eq. 5)."""
        return replace(self, model=rotated(self.model, turn_rad))


def toeplitz(h: NDArray[np.float64], N_c: int) -> Matrix:
    """Φ (N_p·n_y, N_c·n_u) of eq. 15, the block-Toeplitz matrix of h (N_p, n_y, n_u)."""
    N_p, n_y, n_u = h.shape
    padded = np.zeros((N_c - 1 + N_p, n_y, n_u))
    padded[N_c - 1 :] = h
    s_block, s_row, s_column = padded.strides
    blocks = as_strided(
        padded[N_c - 1 :],
        shape=(N_p, n_y, N_c, n_u),
        strides=(s_block, s_row, -s_block, s_column),
        writeable=False,
    )
    return blocks.reshape(N_p * n_y, N_c * n_u)


def summed_moves(N_c: int, n_u: int) -> Matrix:
    """C2 (eq. 19): U = C1 u(k−1) + C2 ΔU, block lower-triangular ones."""
    C2, lower = np.zeros((N_c, n_u, N_c, n_u)), np.tri(N_c)
    for axis in range(n_u):
        C2[:, axis, :, axis] = lower
    return C2.reshape(N_c * n_u, N_c * n_u)


@dataclass(frozen=True, eq=False)
class CondensedMatrices:
    """Constant parts of the condensed problem in SI units.

    E (n, n), F_x (n, n_x), F_held (n, n_y) with F_k = F_x x + F_held y_d for a reference that is
    constant over the horizon; F (N_p·n_y, n_x) and the Markov parameters h (N_p, n_y, n_u) of
    eq. 15; Q (n_y, n_y); the terminal cost that E, F_x and F_held hold too, if there is one.
    """

    E: Matrix
    F_x: Matrix
    F_held: Matrix
    F: Matrix
    h: NDArray[np.float64]
    Q: Matrix
    end: TerminalCost | None = None

    @cached_property
    def Phi(self) -> Matrix:
        """Φ (N_p·n_y, n) of eq. 15."""
        return toeplitz(self.h, self.E.shape[0] // self.h.shape[2])

    @cached_property
    def F_y(self) -> Matrix:
        """−Φᵀ Q̄ (n, N_p·n_y): F_k = F_x x + F_y Y_d for a reference Y_d that is not constant."""
        N_p, n_y, _ = self.h.shape
        n = self.E.shape[0]
        blocks = self.Phi.reshape(N_p, n_y, n).transpose(2, 0, 1)
        F_y = -(blocks @ self.Q).reshape(n, N_p * n_y)
        if self.end is not None:
            F_y[:, -n_y:] += self.end.F_y
        return F_y


def condense_matrices(problem: ControlProblem) -> CondensedMatrices:
    """Condense the horizon: everything of eq. 15-24 that does not change from step to step."""
    model, Q = problem.model, problem.Q
    parts = condense_blocks(model.A, model.B, model.C, Q, problem.R, problem.N_p, problem.N_c)
    E, F_x, F_held, F, h = parts
    if problem.terminal == "none":
        return CondensedMatrices(E, F_x, F_held, F, h, Q)
    end = terminal_cost(model, Q, problem.R, problem.du_max, problem.N_p, problem.N_c)
    return CondensedMatrices(E + end.E, F_x + end.F_x, F_held + end.F_y, F, h, Q, end)


def affine_map(problem: ControlProblem, matrices: CondensedMatrices, units: UnitSystem) -> Matrix:
    """Z (n + 2m, n_x + n_y + n_u + 1) with [q; l; u] = Z [x; y_ref; u_prev; 1] (eq. 20-24)."""
    unit = problem.du_max if units == "scaled" else np.ones(problem.model.n_u)
    Z: Matrix = map_blocks(matrices.F_x, matrices.F_held, problem.u_min, problem.u_max, unit)
    return Z
