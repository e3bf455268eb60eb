"""Thrust allocation: at each sample, as the second QP of a cascade; static, of a mean load.

    min ½ fᵀW f + ½ ΔfᵀR Δf + ½ sᵀΩ s,   f = f_prev + Δf
    s.t. T_e f + s = τ_c                 s, the slack, is the missing part of the demanded force
         low ≤ G f ≤ high                     polygons of the thrusters (`thruster_rows.py`)
         −Δf_max ≤ Δf ≤ Δf_max

Scaled: z = [Δf/Δf_max; s/Δτ_max], the first rows over Δτ_max, the others over the change of G f by
a full step. The slack leaves a feasible point for every demand; with Ω large against W and R it is
next to nothing wherever the demand can be met, and falls as 1/Ω (Fossen 2021, section 11.2).
[q; l; u] is an affine map of [τ_c; f_prev; 1]: a step is one matrix-vector product, as in
`CondensedQP`.

Static allocation balances a mean load with the least effort:

    min ½ Σ |f_i/T_i|²   subject to   T_e f = −load,   f_i in its piece of what thruster i may give

Scaled: z = f/T with the nominal thrusts T, the balance over ΣT and ΣT·arm. The rows are

    balance (3)    T_e T z = −load                     as equalities
    thrusters      of `thruster_rows.py`, ± β_i           circles as polygons with `sides` sides
    sectors        0 ≤ n·z_i ≤ 2                       of an azimuth's piece, two each
    chords         −2 ≤ n·z_i ≤ β_i h                  in which losses cut the circle

Where a piece has no sector or fewer chords than another of the same batch, rows that never bind
(−2 ≤ n·z ≤ 2) stand in, so that all QPs of a batch have one shape; |z_i| ≤ 1 keeps them away. A
lost thruster has no part in the balance; that it gives nothing is then the cost's doing, and no
limit of it is degenerate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.thruster_rows import (
    NOTHING_LOST,
    LimitRampDown,
    Limits,
    ThrusterRows,
    build_limit_rows_of_thrusters,
)
from dpbench.qp.program import QPStep, QuadraticProgram, Units, require_shapes_and_make_contiguous
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import ThrusterSet

NEVER = 2.0  # A limit no thruster reaches: in units of its nominal thrust it gives 1 at most


class StaticAllocation:
    """Builder of the QPs that test whether thrusters can balance a static load.

    thrusters : p of them; their own sectors are ignored, as pieces carry them.
    sides : of the polygon of an azimuth, even.
    sectors, chords : (p,) whether any piece of a thruster has a sector, and its most chords.
    """

    def __init__(
        self, thrusters: ThrusterSet, sides: int, sectors: Sequence[bool], chords: Sequence[int]
    ) -> None:
        round_ones = tuple(replace(t, sector_rad=None) for t in thrusters.thrusters)
        self._thrusters = thrusters
        self._rows = build_limit_rows_of_thrusters(ThrusterSet(round_ones, thrusters.where), sides)
        self._extra = [2 * int(has) + count for has, count in zip(sectors, chords, strict=True)]
        self._sectors = list(sectors)
        self.units = compute_balance_units(thrusters)
        self._balance = build_balance_matrix(thrusters)

    def build_qp_for_static_load(
        self, load: Vector, shares: Vector, chosen: Sequence[Piece], lost: frozenset[int]
    ) -> QuadraticProgram:
        """Return the QP that allocates a static load to thrusters, each in one convex force region.

        load : (3,) mean load times its factor [N, N, N·m]; chosen : (p,) a piece of each thruster;
        shares : (p,) effective over nominal thrust; lost : indices of those that give nothing.
        """
        T, rows = self._thrusters.largest_thrusts_N, self._rows
        given = [i not in lost for i in range(len(T))]
        over = shares[rows.thruster] / T[rows.thruster]
        blocks = [self._build_sector_and_chord_rows(i, chosen[i], shares[i]) for i in range(len(T))]
        balance = self._balance * self._thrusters.repeat_for_each_force_entry(
            np.array(given, dtype=np.float64)
        )
        A = np.vstack([balance, rows.G, *(block[0] for block in blocks)])
        right = -load / self.units
        low = np.concatenate([right, rows.low * over, *(block[1] for block in blocks)])
        high = np.concatenate([right, rows.high * over, *(block[2] for block in blocks)])
        n = self._thrusters.n_f
        return QuadraticProgram(np.eye(n), np.zeros(n), A, low, high, -np.ones(n), np.ones(n))

    def _build_sector_and_chord_rows(
        self, i: int, piece: Piece, share: float
    ) -> tuple[Matrix, Vector, Vector]:
        """Return rows, low and high that keep an azimuth in its sector and inside loss chords."""
        count = self._extra[i]
        normals = np.tile([1.0, 0.0], (count, 1))
        low, high = np.full(count, -NEVER), np.full(count, NEVER)
        first = 0
        if self._sectors[i]:
            first = 2
            if piece.sector is not None:
                normals[:2], low[:2] = compute_sector_normals(*piece.sector), 0.0
        cut = slice(first, first + len(piece.chords))
        normals[cut], high[cut] = piece.chords[:, :2], share * piece.chords[:, 2]
        A = np.zeros((count, self._thrusters.n_f))
        if count:
            A[:, self._thrusters.slices_in_force_vector[i]] = normals
        return A, low, high


class AllocationAfterLoss:
    """Builder of the QPs that allocate a force after thruster losses, with constant matrices.

        min ½ Σ |f_i/T_i|²   subject to   T_e f = τ,   low ≤ G f ≤ high,   lost ones f_i = 0

    Scaled as above. A loss is a limit, so that a workspace goes on from one load or loss to the
    next; without a slack an unattainable force leaves no feasible point. rows : r limits.
    """

    def __init__(self, thrusters: ThrusterSet, rows: ThrusterRows) -> None:
        self._units = compute_balance_units(thrusters)
        self._thrust = thrusters.largest_thrusts_N[rows.thruster]
        self._A = np.vstack([build_balance_matrix(thrusters), rows.G])

    def stack_row_limits_of_demands(
        self, force: Matrix, low: Matrix, high: Matrix
    ) -> tuple[Matrix, Matrix]:
        """Return QP row limits (K, 3 + r) for K demanded forces and thruster limits (K, r) [N]."""
        balance = force / self._units
        return (np.hstack([balance, low / self._thrust]), np.hstack([balance, high / self._thrust]))

    def make_qp_with_row_limits(self, l: Vector, u: Vector) -> QuadraticProgram:  # noqa: E741 - of l ≤ Az ≤ u
        """Return the allocation QP with row limits l and u (3 + r,)."""
        n = self._A.shape[1]
        return QuadraticProgram(np.eye(n), np.zeros(n), self._A, l, u, -np.ones(n), np.ones(n))


def compute_sector_normals(start: float, end: float) -> Matrix:
    """Return inward normals (2, 2) of the sector between two directions [rad]."""
    return np.array([(-np.sin(start), np.cos(start)), (np.sin(end), -np.cos(end))])


def compute_balance_units(thrusters: ThrusterSet) -> Vector:
    """Return the units (3,) of the force balance: ΣT [N], ΣT [N], ΣT times longest arm [N·m]."""
    total = float(thrusters.largest_thrusts_N.sum())
    return np.array([total, total, total * thrusters.longest_arm_m])


def build_balance_matrix(thrusters: ThrusterSet) -> Matrix:
    """Return the scaled matrix (3, n_f) from relative thruster forces to force and moment."""
    thrust = thrusters.repeat_for_each_force_entry(thrusters.largest_thrusts_N)
    matrix: Matrix = thrusters.T_e * thrust / compute_balance_units(thrusters)[:, np.newaxis]
    return matrix


@dataclass(frozen=True, eq=False)
class AllocationProblem:
    """Weights and limits of a dynamic thrust allocation, in SI units.

    T_e : (3, n_f) configuration matrix; rows : r limits of the thrusters.
    W, R : (n_f, n_f) weights of f and of Δf; slack : (3, 3) Ω, that of the force not delivered.
    df_max : (n_f,) largest Δf of a sample; step_max : (3,) unit of the slack, the rate limit of the
    demanded force in a sample.
    """

    T_e: Matrix
    rows: ThrusterRows
    W: Matrix
    R: Matrix
    slack: Matrix
    df_max: Vector
    step_max: Vector

    def __post_init__(self) -> None:
        n_f = len(self.rows.entry)
        shapes: dict[str, tuple[int, ...]] = {"T_e": (AXES, n_f), "W": (n_f, n_f), "R": (n_f, n_f)}
        shapes |= {"slack": (AXES, AXES), "df_max": (n_f,), "step_max": (AXES,)}
        require_shapes_and_make_contiguous(self, shapes)

    @cached_property
    def largest_row_changes_per_step(self) -> Vector:
        """Unit of each thruster-limit row (r,): its change by a maximum increment."""
        return self.rows.largest_row_changes_per_step(self.df_max)

    def compute_weighted_pseudo_inverse(self, lost: Flags = NOTHING_LOST) -> Matrix:
        """Return the weighted pseudo-inverse (n_f, 3) of T_e, an allocation without limits.

        Thrusters that are `lost` (p,) get nothing; where the others cannot make every force,
        it is that of least squares in units of `step_max`.
        """
        works = np.isin(self.rows.entry, np.flatnonzero(lost), invert=True)
        root = np.linalg.cholesky(np.linalg.inv(self.W))
        root[~works] = 0.0
        scaled = self.T_e @ root / self.step_max[:, np.newaxis]
        inverse: Matrix = root @ np.linalg.pinv(scaled) / self.step_max
        return inverse


class AllocationQP:
    """Builder of the thrust-allocation QP of each step, in scaled or SI units.

    P (n, n), A (m, n), lb, ub (n,) : constant; n = n_f + 3, the slacks last, and m = 3 + r.
    Z (n + 2m, 3 + n_f + 1) : the affine map [q; l; u] = Z [τ_c; f_prev; 1].
    scale : how z and the rows relate to the scaled ones (`Units`).
    """

    def __init__(self, problem: AllocationProblem, *, units: UnitSystem = "scaled") -> None:
        self.allocation, self.units = problem, units
        n_f, r = len(problem.df_max), len(problem.largest_row_changes_per_step)
        self.n_f, self.n, self.m = n_f, n_f + AXES, AXES + r
        unit = np.concatenate([problem.df_max, problem.step_max])
        row_unit = np.concatenate([problem.step_max, problem.largest_row_changes_per_step])
        si, one = Units(unit, row_unit), Units(np.ones(self.n), np.ones(self.m))
        # What one unit of a variable and of a row is in [N, N·m] is the other of the two.
        self.scale, own = (one, si) if units == "scaled" else (si, one)
        self._unit, self._row_unit = own.z, own.row
        self._build_matrices_and_affine_maps()
        self._theta = np.ones(AXES + n_f + 1)
        of_limits = problem.largest_row_changes_per_step / self._row_unit[AXES:]
        rates = problem.df_max, problem.largest_row_changes_per_step
        self._ramp_down = LimitRampDown(problem.rows, *rates, 1, factor=of_limits)

    def _build_matrices_and_affine_maps(self) -> None:
        """Build matrices, bounds and affine maps of the QP that allocates a force to thrusters."""
        problem, n_f, n, m = self.allocation, self.n_f, self.n, self.m
        unit, row_unit = self._unit, self._row_unit[:, np.newaxis]
        P, A = np.zeros((n, n)), np.zeros((m, n))
        P[:n_f, :n_f], P[n_f:, n_f:] = problem.W + problem.R, problem.slack
        A[:AXES, :n_f], A[:AXES, n_f:] = problem.T_e, np.eye(AXES)
        A[AXES:, :n_f] = problem.rows.G
        self.P: Matrix = P * np.outer(unit, unit)
        self.A: Matrix = A * unit / row_unit
        bound = np.concatenate([problem.df_max / unit[:n_f], np.full(AXES, np.inf)])
        self.lb: Vector = -bound
        self.ub: Vector = bound
        q, limits = np.zeros((n, AXES + n_f + 1)), np.zeros((2, m, AXES + n_f + 1))
        f = slice(AXES, AXES + n_f)
        q[:n_f, f] = problem.W
        limits[:, :AXES, :AXES], limits[:, :, f] = np.eye(AXES), -A[:, :n_f]
        limits[0, AXES:, -1], limits[1, AXES:, -1] = problem.rows.low, problem.rows.high
        self.Z: Matrix = np.vstack([q * unit[:, np.newaxis], *(limits / row_unit)])

    def emit(self, tau: Vector, f_prev: Vector, *, limits: Limits | None = None) -> QPStep:
        """Return the allocation QP of one step for a demanded force tau, in newly allocated memory.

        tau : (3,) τ_c, the force demanded [N, N, N·m]; f_prev : (n_f,) forces of the thrusters in
        the last sample [N]; limits : [N], in force from now on instead of those of the problem; a
        thruster beyond them may retreat straight to zero (`LimitRampDown`).
        """
        theta, n, cut = self._theta, self.n, self.n + self.m
        theta[:AXES], theta[AXES:-1] = tau, f_prev
        out = self.Z.dot(theta)
        step = QPStep(out[:n], out[n:cut], out[cut:])
        # The two sides of an equality are equal to the last bit, in whatever order a product adds.
        step.u[:AXES] = step.l[:AXES]
        if limits is not None:
            self._ramp_down.write_limits(f_prev, limits, step.l[AXES:], step.u[AXES:])
        return step

    def make_qp_of_zero_demand(self) -> QuadraticProgram:
        """Return the QP of zero force and zero demand, to set up a solver's workspace."""
        return self.problem(self.emit(np.zeros(AXES), np.zeros(self.n_f)))

    def problem(self, step: QPStep) -> QuadraticProgram:
        """Return the complete allocation QP of a step."""
        vectors = step.q, self.A, step.l, step.u, self.lb, self.ub
        return QuadraticProgram(self.P, *vectors, moves=self.n_f)

    def moves(self, z: Vector) -> Vector:
        """Return the changes Δf (n_f,) [N] of the thruster forces in a solution z."""
        delta_f: Vector = z[: self.n_f] * self._unit[: self.n_f]
        return delta_f
