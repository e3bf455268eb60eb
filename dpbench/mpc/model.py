"""The prediction model (paper section III.A, eq. 5-11).

    ẋ_m = A_c x_m + B_c u,   y = C_c x_m,   x_m = [ν; η]          (eq. 7-8, linearised at ψ0)
    x_m(k+1) = A_m x_m(k) + B_m u(k)                              (eq. 9, exact zero-order hold)
    x(k+1) = A x(k) + B Δu(k),   y = C x,   x = [Δx_m; y]         (eq. 11, incremental)

Because the model is incremental, a constant disturbance and a constant u drop out of it: the
paper's u = τ + Rᵀb (eq. 7) differs from τ by a constant at low frequency, and Δu = Δτ.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix
from dpbench.errors import ShapeError
from dpbench.qp.program import require_shapes_and_make_contiguous
from dpbench.ship.layout import AXES

SPEED_CHANGE, POSE_CHANGE, POSE = (slice(first, first + AXES) for first in (0, AXES, 2 * AXES))
"""Δν, Δη and y = η in the state x of a ship's incremental model."""
SHIP_STATES = 3 * AXES
HEADING = SHIP_STATES - 1  # The measured heading in x
HORIZONTAL = slice(0, 2)  # North and east among the outputs


class ThetaLayout(NamedTuple):
    """Slices of state, reference and last input in the QP parameters [x; y_ref; u_prev; 1]."""

    x: slice
    y_ref: slice
    u_prev: slice
    one: int
    size: int


def build_rotation_matrix(psi_rad: float) -> Matrix:
    """Return the rotation matrix R(ψ) (3, 3) from the body to the north-east-down frame (eq. 3)."""
    c, s = np.cos(psi_rad), np.sin(psi_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Linear discrete-time state-space model x⁺ = A x + B u, y = C x."""

    A: Matrix
    B: Matrix
    C: Matrix

    def __post_init__(self) -> None:
        n_x, n_u, n_y = np.shape(self.A)[0], np.shape(self.B)[-1], np.shape(self.C)[0]
        require_shapes_and_make_contiguous(
            self, {"A": (n_x, n_x), "B": (n_x, n_u), "C": (n_y, n_x)}
        )

    @property
    def n_x(self) -> int:
        """Number n_x of the model's states x."""
        return int(self.A.shape[0])

    @property
    def n_u(self) -> int:
        """Number n_u of the model's inputs u, the columns of B."""
        return int(self.B.shape[1])

    @property
    def n_y(self) -> int:
        """Number n_y of the model's outputs y, the rows of C."""
        return int(self.C.shape[0])

    @property
    def theta(self) -> ThetaLayout:
        """Layout of the parameter vector [x; y_ref; u_prev; 1] for a model of this size."""
        reference, force = self.n_x, self.n_x + self.n_y
        one = force + self.n_u
        parts = slice(0, reference), slice(reference, force), slice(force, one)
        return ThetaLayout(*parts, one, one + 1)


def linearise_ship_at_heading(M: Matrix, D: Matrix, psi0_rad: float) -> StateSpace:
    """Return continuous matrices A_c, B_c, C_c of the ship linearised at heading ψ0 (eq. 5-8)."""
    zero = np.zeros((AXES, AXES))
    A_c = np.block([[-np.linalg.solve(M, D), zero], [build_rotation_matrix(psi0_rad), zero]])
    B_c = np.vstack([np.linalg.inv(M), zero])
    C_c = np.hstack([zero, np.eye(AXES)])
    return StateSpace(A_c, B_c, C_c)


def discretise_zero_order_hold(continuous: StateSpace, sample_s: float) -> StateSpace:
    """Discretise a continuous model exactly under zero-order hold (eq. 9-10).

    exp([[A_c, B_c], [0, 0]] ΔT) = [[A_m, B_m], [0, I]] (Van Loan 1978, IEEE TAC 23(3)).
    """
    n_x, n_u = continuous.n_x, continuous.n_u
    block = np.zeros((n_x + n_u, n_x + n_u))
    block[:n_x, :n_x] = continuous.A
    block[:n_x, n_x:] = continuous.B
    held = scipy.linalg.expm(block * sample_s)
    return StateSpace(held[:n_x, :n_x], held[:n_x, n_x:], continuous.C)


def augment_to_incremental_model(discrete: StateSpace) -> StateSpace:
    """Return the incremental model on x = [Δx_m; y], which adds integral action (eq. 11)."""
    A_m, B_m, C_m = discrete.A, discrete.B, discrete.C
    n_x, n_y = discrete.n_x, discrete.n_y
    A = np.block([[A_m, np.zeros((n_x, n_y))], [C_m @ A_m, np.eye(n_y)]])
    B = np.vstack([B_m, C_m @ B_m])
    C = np.hstack([np.zeros((n_y, n_x)), np.eye(n_y)])
    return StateSpace(A, B, C)


def build_prediction_model(M: Matrix, D: Matrix, psi0_rad: float, sample_s: float) -> StateSpace:
    """Return a ship's incremental discrete-time model linearised at heading ψ0, from a cache."""
    inertia, damping = (np.asarray(matrix, dtype=np.float64).tobytes() for matrix in (M, D))
    return _build_cached_prediction_model(inertia, damping, psi0_rad, sample_s)


@lru_cache(maxsize=64)
def _build_cached_prediction_model(
    M: bytes, D: bytes, psi0_rad: float, sample_s: float
) -> StateSpace:
    """Make the discrete augmented model of a ship; cached, with its matrices as bytes."""
    inertia, damping = (np.frombuffer(part).reshape(AXES, AXES) for part in (M, D))
    return augment_to_incremental_model(
        discretise_zero_order_hold(linearise_ship_at_heading(inertia, damping, psi0_rad), sample_s)
    )


def relinearise_model_at_turned_heading(model: StateSpace, turn_rad: float) -> StateSpace:
    """Return a ship's incremental model re-linearised at a heading turned by `turn_rad`.

    ψ0 enters A_c through η̇ = R(ψ0) ν alone, so with η_b = Rᵀη the model is that of ψ0 = 0 and
    x ↦ T x, T = diag(I, R, R), takes one to the other: A ↦ T A Tᵀ, B ↦ T B. As A keeps Δη and y
    whole, only their rows over Δν, and those of B, change: both are linear in R. `model` has the 9
    states and 3 outputs of `build_prediction_model`.
    """
    sizes = model.n_x, model.n_y
    if sizes != (SHIP_STATES, AXES):
        raise ShapeError(
            "relinearise_model_at_turned_heading",
            "model",
            f"{model.n_x} states and {model.n_y} outputs",
            "the 9 states and 3 outputs of a ship",
        )
    R, A, B = build_rotation_matrix(turn_rad), model.A.copy(), model.B.copy()
    for rows in (POSE_CHANGE, POSE):
        A[rows, SPEED_CHANGE] = R @ A[rows, SPEED_CHANGE]
        B[rows] = R @ B[rows]
    return StateSpace(A, B, model.C)
