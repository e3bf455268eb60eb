"""Blocks of rows and slacks on the moves of the condensed QP, in scaled units.

    variables of a move   [Δu/Δu_max; slacks of the blocks in turn]
    rows of a move        [rows of the blocks in turn]
    low [θ; 1] ≤ A_moves z + A_slack s ≤ high [θ; 1],   s ≥ 0,   cost ρᵀs + ½ ε sᵀs

Every block adds the same rows and slacks to each move, so that a warm start can be shifted.

The penalty is exact (Fletcher 1987, section 14.3): where the problem with hard rows is feasible and
ρ exceeds the sum of the multipliers on the rows of a slack, s = 0 is optimal and the plan is that
of the hard problem, whatever ε, because εs vanishes at s = 0. ε > 0 only keeps P definite.

Bounds on the predicted outputs, x ∈ X of the paper's Algorithm 1, are a watch circle and a speed:

    dᵀ(p(k+i) − c) − s ≤ r_K,    dᵀ(p(k+i) − p(k+i−1))/ΔT − s ≤ v_K,    s ≥ 0
    d = (cos 2πj/K, sin 2πj/K),  j = 0 … K−1;    r_K, v_K = cos(π/K) times the radius, the speed

Circles in the horizontal plane become regular polygons of K sides in the north-east frame, inside
the circle, so what satisfies the rows satisfies the circle; eight sides give away 8 % of it at
most. They hold at N_c instants i = N_p/N_c, 2N_p/N_c, …, N_p, one per move, so that all moves have
the same rows; each row has a slack of its own.
"""

from dataclasses import dataclass, replace

import numpy as np

from dpbench.arrays import Floats, Indices, Matrix, Vector
from dpbench.errors import ShapeError
from dpbench.mpc.condense import (
    CondensedMatrices,
    ControlProblem,
    build_rows_of_summed_increments,
    scale_amplitude_limit_rows,
)
from dpbench.mpc.model import HORIZONTAL
from dpbench.qp.program import Units
from dpbench.ship.layout import AXES


@dataclass(frozen=True, eq=False)
class Penalty:
    """Linear and quadratic costs of the slack variables, in scaled units.

    amplitude : (n_u,) ρ of the amplitude slacks, per maximum increment above the limit; of
    thrusters (p,), each of which has one slack for all its sides. outputs : ρ of the output
    slacks, per unit of their rows. curvature : ε.
    """

    amplitude: Vector
    outputs: float
    curvature: float

    @classmethod
    def choose_exact_penalty(cls, problem: ControlProblem, P: Matrix) -> "Penalty":
        """Return slack penalties large enough to be exact, from the scaled Hessian P (n, n).

        A multiplier of an amplitude row is the slope of the cost along a force: P times the
        distance d between the plan and the unconstrained one, at most ‖P_i‖_1 d while no rate limit
        acts. ρ takes d = ¼ (u_max − u_min)/Δu_max in every move, some 19 maximum increments: enough
        for offsets of 20 m or 25° under tuning `robust`, of 3.5 m or 15° under `paper`, with all
        vessels. For outputs it takes one move of ½ the range, max|P_ij| times it. More is no safer:
        at four times these numbers augmented-Lagrangian solvers call the problem infeasible. ε is
        the smallest eigenvalue of P, so that cond(P) stays.
        """
        size, n_u = np.abs(P), problem.model.n_u
        span = (problem.u_max - problem.u_min) / problem.row_max
        largest = size.sum(axis=1).reshape(-1, n_u).max(axis=0)
        if problem.thrusters is not None:
            span, largest = problem.thrusters.row_and_entry_maxima_by_thruster(span, largest)
        amplitude = 0.25 * span * largest
        outputs = 0.5 * float(span.max() * size.max())
        return cls(amplitude, outputs, float(np.linalg.eigvalsh(P)[0]))


@dataclass(frozen=True, eq=False)
class ConstraintBlock:
    """Constraint rows and slack variables that are added to every move of a condensed QP.

    A_moves : (N_c, r, N_c·n_u) coefficients of the moves; A_slack : (r, s) of the move's slacks.
    low, high : (N_c, r, n_θ + 1) limits as maps of [θ; 1]; ±inf in the last column.
    row_unit, slack_unit : (r,), (s,) SI values of one scaled unit; rho : (s,) penalties.
    """

    A_moves: Floats
    A_slack: Matrix
    low: Floats
    high: Floats
    row_unit: Vector
    slack_unit: Vector
    rho: Vector


def make_infinite_limit_coefficients(like: Floats, sign: float) -> Floats:
    """Return coefficients of row limits that are infinite for all parameters, shaped as `like`."""
    rows = np.zeros_like(like)
    rows[..., -1] = sign * np.inf
    return rows


def build_amplitude_constraint_block(
    problem: ControlProblem, Z: Matrix, rho: Vector | None
) -> ConstraintBlock:
    """Return constraints of the input amplitude limits, softened by slacks if penalties are given.

    Z is the scaled map of the plain problem. Hard, a move has r two-sided rows; soft, it has r
    upper rows G C2 z − s ≤ u, then r lower rows G C2 z + s ≥ l.
    """
    n_u, N_c, r, unit = problem.model.n_u, problem.N_c, len(problem.G), problem.row_max
    n = N_c * n_u
    sums = build_rows_of_summed_increments(
        N_c, scale_amplitude_limit_rows(problem, "scaled")
    ).reshape(N_c, r, n)
    low, high = Z[n:].reshape(2, N_c, r, -1)
    if rho is None:
        nothing = np.zeros(0)
        return ConstraintBlock(sums, np.zeros((r, 0)), low, high, unit, nothing, nothing)
    own, slack_unit = np.eye(r), unit
    if problem.thrusters is not None:
        own = np.eye(len(rho))[problem.thrusters.thruster]
        slack_unit, _ = problem.thrusters.row_and_entry_maxima_by_thruster(unit, problem.du_max)
    rows = np.concatenate((sums, sums), axis=1), np.vstack((-own, own))
    lower = np.concatenate((make_infinite_limit_coefficients(high, -1.0), low), axis=1)
    upper = np.concatenate((high, make_infinite_limit_coefficients(low, 1.0)), axis=1)
    return ConstraintBlock(*rows, lower, upper, np.concatenate((unit, unit)), slack_unit, rho)


@dataclass(frozen=True, eq=False)
class AssembledBlocks:
    """Matrices of a condensed QP with constraint blocks and slacks."""

    P: Matrix
    A: Matrix
    lb: Vector
    ub: Vector
    Z: Matrix
    si: Units
    block: int

    def convert_to_si_units(self) -> "AssembledBlocks":
        """Return the assembled QP with variables and rows converted to SI units."""
        z, row = self.si.z, self.si.row
        P, A = self.P / np.outer(z, z), self.A * row[:, np.newaxis] / z
        Z = self.Z * np.concatenate((1.0 / z, row, row))[:, np.newaxis]
        return replace(self, P=P, A=A, lb=self.lb * z, ub=self.ub * z, Z=Z)


def assemble_qp_of_cost_and_blocks(
    P: Matrix, Z_q: Matrix, du_max: Vector, blocks: list[ConstraintBlock], epsilon: float
) -> AssembledBlocks:
    """Assemble a QP from the scaled cost of the moves and constraint blocks with slacks."""
    n_u, N_c = len(du_max), len(P) // len(du_max)
    units = np.concatenate([du_max, *(part.slack_unit for part in blocks)])
    rows = np.concatenate([part.row_unit for part in blocks])
    block, m, width = len(units), N_c * len(rows), Z_q.shape[1]
    n = N_c * block
    whole_P, A = np.diag(np.full(n, epsilon)), np.zeros((m, n))
    of_q, of_low, of_high = np.zeros((n, width)), np.zeros((m, width)), np.zeros((m, width))
    place, row_place = np.arange(n).reshape(N_c, block), np.arange(m).reshape(N_c, -1)
    moves = place[:, :n_u].reshape(-1)
    whole_P[np.ix_(moves, moves)] = P
    of_q[moves] = Z_q
    row, column = 0, n_u
    for part in blocks:
        r, s = part.A_slack.shape
        own, slacks = row_place[:, row : row + r], place[:, column : column + s]
        A[own[:, :, np.newaxis], moves] = part.A_moves
        A[own[:, :, np.newaxis], slacks[:, np.newaxis]] = part.A_slack
        of_q[slacks, -1] = part.rho
        of_low[own], of_high[own] = part.low, part.high
        row, column = row + r, column + s
    lb, ub = np.zeros((N_c, block)), np.full((N_c, block), np.inf)
    lb[:, :n_u], ub[:, :n_u] = -1.0, 1.0
    si = Units(np.tile(units, N_c), np.tile(rows, N_c))
    Z = np.concatenate((of_q, of_low, of_high))
    return AssembledBlocks(whole_P, A, lb.reshape(-1), ub.reshape(-1), Z, si, block)


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
            "OutputBounds",
            "model.C",
            problem.model.C.shape,
            "3 rows, one for each output of a ship",
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

    One unit of a row is the effect of a maximum increment at k of the strongest axis at the last
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
