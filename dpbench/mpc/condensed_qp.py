"""`CondensedQP`: the builder that emits the QP of every step of the DP controller.

A constructor that may be slow, and `emit`, which may not: one product Z [θ; 1] into fresh memory
and three views of it.
"""

from __future__ import annotations

import numpy as np

from dpbench.errors import InputError
from dpbench.mpc.condense import (
    CondensedMatrices,
    ControlProblem,
    UnitSystem,
    affine_map,
    condense_matrices,
    summed_moves,
)
from dpbench.qp.program import Matrix, QPStep, QuadraticProgram, Units, Vector
from dpbench.qp.solution import Solution


class CondensedQP:
    """The DP MPC problem in condensed form.

    Parameters
    ----------
    problem : model, horizons, weights and limits in SI units.
    units : "scaled" (z = ΔU/Δu_max) or "si" (z = ΔU in N, N, N·m).

    Attributes
    ----------
    P (n, n), A (m, n), lb, ub (n,) : constant; n = m = N_c·n_u.
    Z (n + 2m, n_θ + 1) : the affine map [q; l; u] = Z [x; y_ref; u_prev; 1].
    matrices : E, F, Φ of the paper in SI units.
    scale : how z and the rows relate to the scaled ones (`Units`).
    """

    def __init__(self, problem: ControlProblem, *, units: UnitSystem = "scaled") -> None:
        if units not in ("scaled", "si"):
            raise InputError("CondensedQP", "units", repr(units), '"scaled" or "si"')
        self.control, self.units = problem, units
        self.matrices: CondensedMatrices = condense_matrices(problem)
        n_u, N_c = problem.model.n_u, problem.N_c
        self.n = self.m = N_c * n_u
        du, one = np.concatenate([problem.du_max] * N_c), np.ones(self.n)
        own = one if units == "scaled" else du
        self._du: Vector = du if units == "scaled" else one
        self.scale = Units(own, own)
        self.P: Matrix = self.matrices.E * (self._du[:, np.newaxis] * self._du)
        self.A: Matrix = summed_moves(N_c, n_u)
        self.ub: Vector = own.copy()
        self.lb: Vector = -own
        self.Z: Matrix = affine_map(problem, self.matrices, units)
        self._prepare_emit()

    def _prepare_emit(self) -> None:
        n_x, n_y, n_u = self.control.model.n_x, self.control.model.n_y, self.control.model.n_u
        theta = np.ones(n_x + n_y + n_u + 1)
        # One tuple of locals instead of eight look-ups, and the bound method, which costs half of
        # numpy.dot(Z, theta): emitting is measured against the bare product.
        self._parts = (
            theta[:n_x],
            theta[n_x : n_x + n_y],
            theta[n_x + n_y : -1],
            theta,
            self.Z.dot,
            self.n,
            self.n + self.m,
        )

    def emit(
        self,
        x: Vector,
        y_ref: Vector,
        u_prev: Vector,
        *,
        limits: tuple[Vector, Vector] | None = None,
    ) -> QPStep:
        """The QP of one step (eq. 20-24), in memory of its own.

        Parameters
        ----------
        x : (n_x,) augmented state [Δν, Δη, y], SI; heading unwrapped.
        y_ref : (n_y,) reference, or (N_p, n_y) for preview; heading within π of y's.
        u_prev : (n_u,) force applied in the last sample [N, N, N·m].
        limits : (u_min, u_max), each (n_u,), in force from now on instead of the vessel's; plan
            row i then gets the reachable ones, max(u_max, u_prev − iΔu_max) and so on, because a
            limit that drops below u_prev by more than one rate step leaves no feasible point.
        """
        x_part, y_part, u_part, theta, product, n, cut = self._parts
        x_part[...] = x
        u_part[...] = u_prev
        preview = y_ref.ndim != 1
        y_part[...] = y_ref[0] if preview else y_ref
        out = product(theta)
        step = QPStep(out[:n], out[n:cut], out[cut:])
        if preview:
            self._preview(step, y_ref)
        if limits is not None:
            self._reachable(step, u_prev, *limits)
        return step

    def _preview(self, step: QPStep, y_ref: Matrix) -> None:
        """Replace the reference held at y_ref[0] by the previewed one, (N_p, n_y)."""
        change = y_ref - y_ref[0]
        step.q += self._du * (self.matrices.F_y @ change.reshape(-1))

    def _reachable(self, step: QPStep, u_prev: Vector, u_min: Vector, u_max: Vector) -> None:
        # In rate-limit steps the reachable bounds −i and i are exact, so a row that is forced to
        # its bound meets it to the last bit and no rounding makes the step infeasible.
        du = self.control.du_max
        i = np.arange(1.0, self.control.N_c + 1)[:, np.newaxis]
        high = np.maximum((u_max - u_prev) / du, -i)
        low = np.minimum((u_min - u_prev) / du, i)
        step.l[:] = low.reshape(-1) * self.scale.row
        step.u[:] = high.reshape(-1) * self.scale.row

    def problem(self, step: QPStep) -> QuadraticProgram:
        """The whole problem of one step."""
        n_u = self.control.model.n_u
        return QuadraticProgram(self.P, step.q, self.A, step.l, step.u, self.lb, self.ub, block=n_u)

    def moves(self, z: Vector) -> Matrix:
        """ΔU as increments (N_c, n_u) in N, N, N·m."""
        return (z * self._du).reshape(self.control.N_c, self.control.model.n_u)

    def plan(self, delta_u: Matrix) -> Vector:
        """z of the increments (N_c, n_u) in N, N, N·m: the inverse of `moves`."""
        return delta_u.reshape(-1) / self._du

    def constant_cost(self, x: Vector, y_ref: Vector) -> float:
        """J0 (eq. 24): objective(z) + J0 is the predicted cost J of eq. 17."""
        y_d = np.tile(y_ref, self.control.N_p) if y_ref.ndim == 1 else y_ref.reshape(-1)
        error = (y_d - self.matrices.F @ x).reshape(self.control.N_p, -1)
        return 0.5 * float(np.einsum("ki,ij,kj->", error, self.control.Q, error))

    def to_scaled(self, solution: Solution) -> Solution:
        """The answer mapped to scaled units: the same plan, multipliers of the scaled rows."""
        if self.units == "scaled":
            return solution
        own = self.scale
        return Solution(
            solution.status,
            solution.z / own.z,
            solution.y * own.row,
            solution.y_box * own.z,
            solution.iterations,
            solution.reported_ns,
            solution.detail,
        )
