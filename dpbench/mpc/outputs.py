"""Bounds on the predicted outputs, x ∈ X of the paper's Algorithm 1: watch circle and speed.

    dᵀ(p(k+i) − c) − s ≤ r_K,    dᵀ(p(k+i) − p(k+i−1))/ΔT − s ≤ v_K,    s ≥ 0
    d = (cos 2πj/K, sin 2πj/K),  j = 0 … K−1;    r_K, v_K = cos(π/K) times the radius, the speed

Circles in the horizontal plane become regular polygons of K sides in the north-east frame, inside
the circle, so what satisfies the rows satisfies the circle; eight sides give away 8 % of it at
most. They hold at N_c instants i = N_p/N_c, 2N_p/N_c, …, N_p, one per move, so that all moves have
the same rows; each row has a slack of its own.
"""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Floats, Indices, Matrix
from dpbench.errors import ShapeError
from dpbench.mpc.condense import CondensedMatrices, ControlProblem
from dpbench.mpc.model import HORIZONTAL
from dpbench.mpc.soft_limits import ConstraintBlock, make_infinite_limit_coefficients
from dpbench.ship.layout import AXES


@dataclass(frozen=True, eq=False)
class OutputBounds:
    """Soft bounds on predicted position (a watch circle) and on predicted speed.

    sample_s : ΔT; sides : K.
    radius_m : of the watch circle around the reference, None for none.
    speed_mps : largest speed over ground, from Δη/ΔT, None for none.
    """

    sample_s: float
    radius_m: float | None = None
    speed_mps: float | None = None
    sides: int = 8

    @property
    def polygon_normals(self) -> Matrix:
        """Outward unit normals (K, 2) of the polygon that replaces a circle."""
        angle = 2.0 * np.pi * np.arange(self.sides) / self.sides
        return np.column_stack((np.cos(angle), np.sin(angle)))


def choose_bounded_prediction_steps(N_p: int, N_c: int) -> Indices:
    """Return the N_c prediction steps at which outputs are bounded, spread evenly up to N_p."""
    return np.arange(1, N_c + 1) * N_p // N_c


def build_output_constraint_blocks(
    problem: ControlProblem, matrices: CondensedMatrices, bounds: OutputBounds, rho: float
) -> list[ConstraintBlock]:
    """Return the soft QP constraints of the position watch circle and of the ship-speed bound."""
    n_y, n_x, n = problem.model.n_y, problem.model.n_x, len(matrices.E)
    if n_y != AXES:
        raise ShapeError.from_shapes(
            "OutputBounds", "model.C", problem.model.C.shape, "3 outputs of a ship"
        )
    # Outputs at steps 0 … N_p as maps of the state and of the scaled plan; north and east only.
    free = np.vstack((problem.model.C, matrices.F)).reshape(-1, n_y, n_x)[:, HORIZONTAL]
    moved = matrices.Phi * np.tile(problem.du_max, problem.N_c)
    moved = np.vstack((np.zeros((n_y, n)), moved)).reshape(-1, n_y, n)[:, HORIZONTAL]
    i = choose_bounded_prediction_steps(problem.N_p, problem.N_c)
    blocks = []
    if bounds.radius_m is not None:
        block = _build_polygon_constraint(problem, bounds, free[i], moved[i], bounds.radius_m, rho)
        # The circle is centred on the reference.
        centre = block.high[:, :, problem.model.theta.y_ref][:, :, HORIZONTAL]
        centre[...] = bounds.polygon_normals / block.row_unit[0]
        blocks.append(block)
    if bounds.speed_mps is not None:
        per_s = 1.0 / bounds.sample_s
        rate, push = per_s * (free[i] - free[i - 1]), per_s * (moved[i] - moved[i - 1])
        blocks.append(_build_polygon_constraint(problem, bounds, rate, push, bounds.speed_mps, rho))
    return blocks


def _build_polygon_constraint(
    problem: ControlProblem,
    bounds: OutputBounds,
    free: Floats,
    moved: Floats,
    radius: float,
    rho: float,
) -> ConstraintBlock:
    """Return constraints that keep a predicted horizontal vector in a polygon around the origin.

    One unit of a row is the effect of a full rate-limit step at k of the strongest axis at the last
    instant; it is the same at every heading.
    """
    K, n_u, theta = bounds.sides, problem.model.n_u, problem.model.theta
    unit = float(np.linalg.norm(moved[-1, :, :n_u], axis=0).max())
    d = bounds.polygon_normals / unit
    high = np.zeros((len(free), K, theta.size))
    high[:, :, theta.x] = -(d @ free)
    high[:, :, theta.one] = np.cos(np.pi / K) * radius / unit
    units = np.full(K, unit)
    rows = d @ moved
    low, rhos = make_infinite_limit_coefficients(high, -1.0), np.full(K, rho)
    return ConstraintBlock(rows, -np.eye(K), low, high, units, units, rhos)
