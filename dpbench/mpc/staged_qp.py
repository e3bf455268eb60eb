"""`StagedQP`: the problem of `CondensedQP` with the states kept, sparse and ordered by stages.

    variables   [Δu_0, u_0, x_1 | … | Δu_{N_c−1}, u_{N_c−1}, x_{N_c} | x_{N_c+1} | … | x_{N_p}]
    rows        u_i − u_{i−1} − Δu_i = 0                                             (eq. 18)
                x_{i+1} − A x_i − B Δu_i = 0                                         (eq. 11)
                u_min ≤ G u_i ≤ u_max                of stage i < N_c, in this order (eq. 19)
                x_{i+1} − A x_i = 0                                       of the stages behind
    bounds      −Δu_max ≤ Δu_i ≤ Δu_max                                              (eq. 21)
    cost        ½ Σ (C x_i − y_d,i)ᵀ Q (C x_i − y_d,i) + ½ Σ Δu_iᵀ R Δu_i            (eq. 17)
                + ½ Σ u_iᵀ W u_i                           where thrusters are weighed too

less the constant part of the cost. θ = [x; y_ref; u_prev] enters by the right-hand sides of the
first two blocks of rows and, y_ref, by q: a step changes vectors only. Forces and states cost
nothing or little, so P is only semidefinite.

Its optimum is that of the condensed problem, multipliers included. With λ_i of the first rows, μ_i
of the second, y_i of the third and r_i of the bounds, stationarity along u_i reads
λ_i − λ_{i+1} + W u_i + Gᵀ y_i = 0, hence λ_i = −Σ_{j≥i} (W u_j + Gᵀ y_j); along x_i it is the
costate recursion μ_{i−1} = Aᵀ μ_i − CᵀQ (C x_i − y_d,i), so that −Bᵀ μ_i is the slope of the
tracking cost along Δu_i; along Δu_i what is left is R Δu_i − Bᵀ μ_i − λ_i + r_i = 0: a row of
E ΔU + F_k + C2ᵀ (I ⊗ Gᵀ) y + r = 0 (eq. 24, 28). A Farkas vector of the staged rows has μ = 0, by
the same recursion without a cost, and leaves C2ᵀ (I ⊗ Gᵀ) y + r = 0 and the same negative sum over
the limits: it proves the condensed problem infeasible too. `convert_solution_to_condensed`
therefore takes Δu_i, y_i and r_i.
"""

from typing import Literal

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.condense import ControlProblem, UnitSystem, solve_discrete_riccati_of_model
from dpbench.mpc.thruster_rows import LimitRampDown, Limits
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution

PlainAmplitude = Literal["reachable", "hard"]  # Policies without slacks


class StagedQP:
    """Builder of the sparse MPC QP, which keeps the predicted states as variables.

    problem : model, horizons, weights and limits in SI units.
    units : "scaled" (Δu and u in steps of the rate limit) or "si"; states are in SI units in both.
    amplitude : policy of the amplitude limits, "reachable" or "hard".

    P (n, n), A (m, n), lb, ub (n,) are constant; n = N_c (2 n_u + n_x) + (N_p − N_c) n_x, and m the
    same with r, the rows of G, for one of the n_u. block is 0: stages with and without a move
    differ in size, so that a warm start cannot be shifted by one move.
    """

    def __init__(
        self,
        problem: ControlProblem,
        *,
        units: UnitSystem = "scaled",
        amplitude: PlainAmplitude = "reachable",
    ) -> None:
        if units not in ("scaled", "si"):
            raise InputError("StagedQP", "units", repr(units), '"scaled" or "si"')
        if amplitude not in ("reachable", "hard"):
            raise InputError("StagedQP", "amplitude", repr(amplitude), '"reachable" or "hard"')
        self.control, self.units, self.amplitude = problem, units, amplitude
        n_x, n_u, N_c = problem.model.n_x, problem.model.n_u, problem.N_c
        self.block = 0
        r, behind = len(problem.G), (problem.N_p - N_c) * n_x
        self._width, self._row_width = 2 * n_u + n_x, n_u + n_x + r
        self._cut, self._row_cut = N_c * self._width, N_c * self._row_width
        self.n, self.m = self._cut + behind, self._row_cut + behind
        scaled = units == "scaled"
        self._unit: Vector = problem.du_max if scaled else np.ones(n_u)
        self._row_unit: Vector = problem.row_max if scaled else np.ones(r)
        self._build_cost_and_reference_map()
        self._build_constraint_matrix()
        # Read-only arrays need not be compared when a solver is set up anew at every step.
        for array in (self.P, self.A, self.lb, self.ub):
            array.setflags(write=False)
        # Largest sum of the moves up to each: (N_c, r).
        self._reach: Matrix = np.outer(np.arange(1.0, N_c + 1), problem.row_max / self._row_unit)
        self._ramp_down: LimitRampDown | None = None
        if problem.thrusters is not None:
            self._ramp_down = LimitRampDown(problem.thrusters, problem.du_max, problem.row_max, N_c)

    def _index_of_stage_in_vector(self, i: int, width: int) -> int:
        """Return the index of stage i in a QP vector, where stages with a move take `width`."""
        behind = max(i - self.control.N_c, 0)
        return (i - behind) * width + behind * self.control.model.n_x

    def _slice_of_stage_state(self, i: int) -> slice:
        """Return the slice of stage i's predicted state in the QP variables."""
        model = self.control.model
        first = self._index_of_stage_in_vector(i, self._width) + (
            2 * model.n_u if i < self.control.N_c else 0
        )
        return slice(first, first + model.n_x)

    def _build_cost_and_reference_map(self) -> None:
        """Build the cost P of moves, forces and states, and its map from the reference."""
        problem, model, unit = self.control, self.control.model, self._unit
        weight = model.C.T @ problem.Q @ model.C
        move = problem.R * np.outer(unit, unit)
        self.P: Matrix = np.zeros((self.n, self.n))
        for i in range(problem.N_c):
            first = self._index_of_stage_in_vector(i, self._width)
            at = slice(first, first + model.n_u)
            self.P[at, at] = 0.5 * (move + move.T)
            if problem.W is not None:
                force = slice(at.stop, at.stop + model.n_u)
                self.P[force, force] = problem.W * np.outer(unit, unit)
        for i in range(problem.N_p):
            self.P[self._slice_of_stage_state(i), self._slice_of_stage_state(i)] = 0.5 * (
                weight + weight.T
            )
        # q along each state, per unit of its reference, and what the last one has on top.
        self._slope: Matrix = -model.C.T @ problem.Q
        self._end: Matrix = np.zeros((model.n_x, model.n_y))
        if problem.terminal == "riccati":
            S = solve_discrete_riccati_of_model(model, problem.Q, problem.R, problem.du_max)
            last = self._slice_of_stage_state(problem.N_p - 1)
            self.P[last, last] = 0.5 * (S + S.T)
            self._end = (weight - S) @ model.C.T
        self._held: Matrix = np.zeros((self.n, model.n_y))
        for i in range(problem.N_p):
            self._held[self._slice_of_stage_state(i)] = self._slope
        self._held[-model.n_x :] += self._end

    def _build_constraint_matrix(self) -> None:
        """Set rows `A` (dynamics, sums of moves, limits, by stage), their limits and bounds."""
        problem, model, unit = self.control, self.control.model, self._unit
        n_u, n_x = model.n_u, model.n_x
        one, B = np.eye(n_u), model.B * unit
        G = problem.G * unit / self._row_unit[:, np.newaxis]
        self.A: Matrix = np.zeros((self.m, self.n))
        low, high = np.zeros(self.m), np.zeros(self.m)
        for i in range(problem.N_p):
            row, first = (
                self._index_of_stage_in_vector(i, self._row_width),
                self._index_of_stage_in_vector(i, self._width),
            )
            if i < problem.N_c:
                du, u = slice(first, first + n_u), slice(first + n_u, first + 2 * n_u)
                moved = slice(row, row + n_u)
                limited = slice(row + n_u + n_x, row + self._row_width)
                self.A[moved, du], self.A[moved, u] = -one, one
                if i > 0:
                    before = self._index_of_stage_in_vector(i - 1, self._width) + n_u
                    self.A[moved, before : before + n_u] = -one
                self.A[limited, u] = G
                low[limited] = problem.u_min / self._row_unit
                high[limited] = problem.u_max / self._row_unit
                row += n_u
                self.A[row : row + n_x, du] = -B
            self.A[row : row + n_x, self._slice_of_stage_state(i)] = np.eye(n_x)
            if i > 0:
                self.A[row : row + n_x, self._slice_of_stage_state(i - 1)] = -model.A
        self._low, self._high = low, high
        self.ub: Vector = np.full(self.n, np.inf)
        self._view_increments_in_variables(self.ub)[...] = problem.du_max / unit
        self.lb: Vector = -self.ub

    def _view_increments_in_variables(self, along: Vector) -> Matrix:
        """Return a view (N_c, n_u) of the control increments in a vector of QP variables."""
        stages = along[: self._cut].reshape(self.control.N_c, self._width)
        return stages[:, : self.control.model.n_u]

    def _view_amplitude_limits_in_rows(self, along: Vector) -> Matrix:
        """Return a view (N_c, r) of the amplitude limits' entries in a vector over QP rows."""
        stages = along[: self._row_cut].reshape(self.control.N_c, self._row_width)
        return stages[:, -len(self._row_unit) :]

    def emit(
        self, x: Vector, y_ref: Vector, u_prev: Vector, *, limits: Limits | None = None
    ) -> QPStep:
        """Return the QP data q, l and u of one control step, in newly allocated memory.

        Under the policy `reachable` a limit is extended as far as the rate allows, rounded to the
        side of the forces that moves can reach, so that no rounding makes the step infeasible.
        """
        model = self.control.model
        n_u, first = model.n_u, model.n_u + model.n_x
        low, high = self._low.copy(), self._high.copy()
        before = u_prev / self._unit
        low[:n_u] = high[:n_u] = before
        low[n_u:first] = high[n_u:first] = model.A.dot(x)
        q = self._held.dot(y_ref) if y_ref.ndim == 1 else self._compute_preview_gradient(y_ref)
        if limits is not None:
            u_min, u_max = self._make_amplitude_limits_reachable(before, limits)
            (
                self._view_amplitude_limits_in_rows(low)[...],
                self._view_amplitude_limits_in_rows(high)[...],
            ) = u_min, u_max
        return QPStep(q, low, high)

    def _make_amplitude_limits_reachable(
        self, before: Vector, limits: Limits
    ) -> tuple[Matrix, Matrix]:
        """Return scaled lower and upper amplitude limits, extended to what the rate can reach."""
        low, high = limits.low / self._row_unit, limits.high / self._row_unit
        if self.amplitude != "reachable":
            return low, high
        if self._ramp_down is None:
            room = self._reach - 2.0 * np.spacing(np.abs(before) + self._reach)
            return np.minimum(low, before + room), np.maximum(high, before - room)
        force = before * self._unit
        along = self.control.G @ force / self._row_unit
        unit = self.control.row_max / self._row_unit
        low, high = self._ramp_down.compute_gradually_tightened_limits(force, limits)
        return along + low * unit, along + high * unit

    def _compute_preview_gradient(self, y_ref: Matrix) -> Vector:
        """Return the gradient q (n,) for a reference (N_p, n_y) that changes along the horizon."""
        N_c, n_x = self.control.N_c, self.control.model.n_x
        along = y_ref @ self._slope.T
        along[-1] += self._end @ y_ref[-1]
        q = np.zeros(self.n)
        q[: self._cut].reshape(N_c, self._width)[:, -n_x:] = along[:N_c]
        q[self._cut :] = along[N_c:].reshape(-1)
        return q

    def problem(self, step: QPStep) -> QuadraticProgram:
        """Return the complete sparse QP of one step, with its stage sizes."""
        n_x, n_u, N_c = self.control.model.n_x, self.control.model.n_u, self.control.N_c
        # Of HPIPM's stages: u_{k-1} and x_k are states of stage k, Δu_k its input.
        moved, last, behind = (n_u + n_x, n_u), (n_u + n_x, 0), (n_x, 0)
        stages = ((0, n_u), *(moved,) * (N_c - 1), last, *(behind,) * (self.control.N_p - N_c))
        vectors = step.q, self.A, step.l, step.u, self.lb, self.ub
        return QuadraticProgram(self.P, *vectors, stages=stages)

    def convert_solution_to_condensed(self, solution: Solution) -> Solution:
        """Convert a sparse solution to the condensed one; NaN stays NaN, a proof stays a proof."""
        return solution.copy_with_other_vectors(
            self._view_increments_in_variables(solution.z).reshape(-1),
            self._view_amplitude_limits_in_rows(solution.y).reshape(-1),
            self._view_increments_in_variables(solution.y_box).reshape(-1),
        )
