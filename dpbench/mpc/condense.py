"""The condensed QP of the paper (eq. 16-25) as constant matrices and one affine map of θ.

    J = ½ (Y_d − Y)ᵀ Q̄ (Y_d − Y) + ½ ΔUᵀ R̄ ΔU                               (eq. 17)
      = ½ ΔUᵀ E ΔU + ΔUᵀ F_k + J0,   E = Φᵀ Q̄ Φ + R̄                          (eq. 24)
    F_k = −Φᵀ Q̄ (D y_d − F x)                                                 (eq. 24)
    U_min ≤ C1 u(k−1) + C2 ΔU ≤ U_max,   −ΔU_max ≤ ΔU ≤ ΔU_max                 (eq. 18-21)

With z = ΔU/Δu_max (`units="scaled"`) the rows are divided by Δu_max too, so that A = C2, lb = −1,
ub = 1 and the cost keeps its value; `units="si"` leaves everything in N and N·m. In both,
[q; l; u] is an affine map of θ = [x; y_ref; u_prev], so a step is one matrix-vector product.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dpbench.errors import InputError, ShapeError
from dpbench.mpc.model import StateSpace
from dpbench.mpc.prediction import markov, toeplitz
from dpbench.qp.program import Matrix, Vector

UnitSystem = Literal["scaled", "si"]


@dataclass(frozen=True, eq=False)
class ControlProblem:
    """What the controller wants and may do, in SI units.

    Parameters
    ----------
    model : the incremental model (eq. 11).
    N_p, N_c : prediction and control horizon, 1 ≤ N_c ≤ N_p.
    Q : (n_y, n_y) output weight; R : (n_u, n_u) weight of the increments; the same at all steps.
    u_min, u_max : (n_u,) amplitude limits; du_max : (n_u,) largest increment per sample.
    """

    model: StateSpace
    N_p: int
    N_c: int
    Q: Matrix
    R: Matrix
    u_min: Vector
    u_max: Vector
    du_max: Vector

    def __post_init__(self) -> None:
        n_u, n_y = self.model.n_u, self.model.n_y
        shapes: dict[str, tuple[int, ...]] = {"Q": (n_y, n_y), "R": (n_u, n_u)}
        shapes |= {"u_min": (n_u,), "u_max": (n_u,), "du_max": (n_u,)}
        for name, shape in shapes.items():
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape:
                raise ShapeError.of("ControlProblem", name, array.shape, f"shape {shape}")
            object.__setattr__(self, name, array)
        if not 1 <= self.N_c <= self.N_p:
            found = f"N_c = {self.N_c}, N_p = {self.N_p}"
            raise InputError("ControlProblem", "N_c", found, "1 ≤ N_c ≤ N_p")


def hessian(h: NDArray[np.float64], Q: Matrix, R: Matrix, N_c: int) -> Matrix:
    """E = Φᵀ Q̄ Φ + R̄ (eq. 24) from the Markov parameters h (N_p, n_y, n_u), without Φ.

    The last block row is Σ_t h_tᵀ Q h_{t+N_c−j}; the others follow along the block diagonals from
    P_ij = P_{i+1,j+1} + h_{N_p−i}ᵀ Q h_{N_p−j} (blocks counted from 1), because Φ is Toeplitz:
    the work grows like the output, (N_c n_u)², plus N_p·N_c for the last row.
    """
    N_p, n_y, n_u = h.shape
    n = N_c * n_u
    tail = toeplitz(h, N_c)[(N_c - 1) * n_y :]
    P = np.empty((n, n))
    P[n - n_u :] = (tail[:, n - n_u :].reshape(-1, n_y, n_u).transpose(2, 0, 1) @ Q).reshape(
        n_u, -1
    ) @ tail
    P[: n - n_u, n - n_u :] = P[n - n_u :, : n - n_u].T
    latest = np.ascontiguousarray(h[N_p - N_c :][::-1].transpose(1, 0, 2)).reshape(n_y, n)
    update = latest.T @ (Q @ latest)
    for i in range(n - 2 * n_u, -1, -n_u):
        np.add(
            P[i + n_u : i + 2 * n_u, n_u:],
            update[i : i + n_u, : n - n_u],
            out=P[i : i + n_u, : n - n_u],
        )
    blocks = P.reshape(N_c, n_u, N_c, n_u)
    for i in range(N_c):
        blocks[i, :, i, :] += R
    # Symmetric to the last bit: some solvers read one triangle only, the referee reads both.
    return 0.5 * (P + P.T)


def summed_moves(N_c: int, n_u: int) -> Matrix:
    """C2 (eq. 19): U = C1 u(k−1) + C2 ΔU, block lower-triangular ones."""
    return np.kron(np.tril(np.ones((N_c, N_c))), np.eye(n_u)).astype(np.float64)


@dataclass(frozen=True, eq=False)
class CondensedMatrices:
    """Constant parts of the condensed problem in SI units.

    E (n, n); F_x (n, n_x) and F_y (n, N_p·n_y) with F_k = F_x x + F_y Y_d; F (N_p·n_y, n_x) and
    Φ (N_p·n_y, n) of eq. 15.
    """

    E: Matrix
    F_x: Matrix
    F_y: Matrix
    F: Matrix
    Phi: Matrix


def condense_matrices(problem: ControlProblem) -> CondensedMatrices:
    """Condense the horizon: everything of eq. 15-24 that does not change from step to step."""
    N_p, N_c, Q = problem.N_p, problem.N_c, problem.Q
    n_y = problem.model.n_y
    F, h = markov(problem.model, N_p)
    Phi = toeplitz(h, N_c)
    n = Phi.shape[1]
    weighted = (Phi.reshape(N_p, n_y, n).transpose(2, 0, 1) @ Q).reshape(n, N_p * n_y)
    return CondensedMatrices(
        E=hessian(h, Q, problem.R, N_c), F_x=weighted @ F, F_y=-weighted, F=F, Phi=Phi
    )


@dataclass(frozen=True, eq=False)
class AffineMap:
    """[q; l; u] = Z [θ; 1] with θ = [x; y_ref; u_prev]; Z (n + 2m, n_θ + 1)."""

    Z: Matrix
    n: int
    m: int


def affine_map(
    problem: ControlProblem, matrices: CondensedMatrices, units: UnitSystem
) -> AffineMap:
    """The affine map of eq. 20-24 in the units asked for, for a reference constant over N_p."""
    n_x, n_y, n_u = problem.model.n_x, problem.model.n_y, problem.model.n_u
    N_p, N_c = problem.N_p, problem.N_c
    n = N_c * n_u
    du = np.tile(problem.du_max, N_c) if units == "scaled" else np.ones(n)
    Z = np.zeros((3 * n, n_x + n_y + n_u + 1))
    Z[:n, :n_x] = du[:, np.newaxis] * matrices.F_x
    summed = matrices.F_y.reshape(n, N_p, n_y).sum(axis=1)
    Z[:n, n_x : n_x + n_y] = du[:, np.newaxis] * summed
    C1 = np.tile(np.eye(n_u), (N_c, 1)) / du[:, np.newaxis]
    for top, limit in ((n, problem.u_min), (2 * n, problem.u_max)):
        Z[top : top + n, n_x + n_y : -1] = -C1
        Z[top : top + n, -1] = np.tile(limit, N_c) / du
    return AffineMap(Z, n, n)
