"""Thrust allocation at each sample: the second QP of a cascade, after a controller of forces.

    min ½ fᵀW f + ½ ΔfᵀR Δf + ½ sᵀΩ s,   f = f_prev + Δf
    s.t. T_e f + s = τ_c                 s, the slack, is the missing part of the demanded force
         low ≤ G f ≤ high                     polygons of the thrusters (`thruster_rows.py`)
         −Δf_max ≤ Δf ≤ Δf_max

Scaled: z = [Δf/Δf_max; s/Δτ_max], the first rows over Δτ_max, the others over the change of G f by
a full step. The slack leaves a feasible point for every demand; with Ω large against W and R it is
next to nothing wherever the demand can be met, and falls as 1/Ω (Fossen 2021, section 11.2).
[q; l; u] is an affine map of [τ_c; f_prev; 1]: a step is one matrix-vector product, as in
`CondensedQP`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.thruster_rows import NOTHING_LOST, LimitRampDown, Limits, ThrusterRows
from dpbench.qp.program import QPStep, QuadraticProgram, Units, require_shapes_and_make_contiguous
from dpbench.ship.layout import AXES


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
        """Unit of each thruster-limit row (r,): its change by a full rate-limit step."""
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
