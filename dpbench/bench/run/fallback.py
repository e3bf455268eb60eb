"""From an answer, or the lack of one, to the force that is applied (method.md section 3)."""

from __future__ import annotations

from functools import partial
from typing import Protocol

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import Fallback
from dpbench.kernel_cache import njit
from dpbench.mpc.condense import CondensedMatrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import Gains, gains
from dpbench.mpc.thruster_rows import LimitRampDown, ThrusterRows
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningQP

CLIP_TOLERANCE = 1e-9
"""In rate-limit steps: below it a violation is rounding, above it `clipped` is recorded."""


class Limit(Protocol):
    """Keeps a move to the limits, the applied force in `applied`; true if that changed anything.

    u (n_u,) the force applied before; du (n_u,) the move; u_min, u_max (r,) limits in force.
    """

    def __call__(
        self, u: Vector, du: Vector, u_min: Vector, u_max: Vector, applied: Vector
    ) -> bool:
        """Write the force that is applied."""


def limit_of(builder: CondensedQP) -> Limit:
    """How the moves of a controller are limited: forces axis by axis, thrusters each as a whole."""
    problem = builder.control
    if problem.thrusters is None:
        return partial(limit_move, problem.du_max)
    turning = builder.turning if isinstance(builder, TurningQP) else None
    return ThrusterLimit(problem.thrusters, problem.du_max, turning)


@njit(cache=True)
def limit_move(du_max, u, du, u_min, u_max, applied):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """applied = clip(u + clip(Δu, ±Δu_max), reachable limits); true if that changed anything.

    The reachable limits of the first move are max(u_max, u − Δu_max) and min(u_min, u + Δu_max):
    rate before amplitude, so no actuator limit is ever violated by an inexact answer. A force
    within rounding of a limit ends exactly on it.
    """
    clipped = False
    for i in range(u.shape[0]):
        move = min(max(du[i], -du_max[i]), du_max[i])
        high = max(u_max[i], u[i] - du_max[i])
        low = min(u_min[i], u[i] + du_max[i])
        force = min(max(u[i] + move, low), high)
        if abs(force - u[i] - du[i]) > CLIP_TOLERANCE * du_max[i]:
            clipped = True
        applied[i] = force
    return clipped


class ThrusterLimit:
    """The same for thrusters, each as a whole (`thruster_rows`).

        applied = b + t (f + clip(Δf, ±Δf_max) − b),   largest t ≤ 1 within low ≤ G · ≤ high

    b is the force before or, where that is beyond a limit by now, the first step of its way back to
    nothing (`LimitRampDown`); b and the clipped move keep to the rate, so all between them do.
    """

    def __init__(
        self, rows: ThrusterRows, du_max: Vector, turning: AzimuthTurning | None = None
    ) -> None:
        self._rows, self._du_max, self._turning = rows, du_max, turning
        self._row_max = rows.units(du_max)
        self._ramp_down = LimitRampDown(rows, du_max, self._row_max, 1)
        self._rounding = CLIP_TOLERANCE * self._row_max

    def __call__(
        self, u: Vector, du: Vector, u_min: Vector, u_max: Vector, applied: Vector
    ) -> bool:
        """Write the forces that are applied; true if that changed anything."""
        rows, du_max = self._rows, self._du_max
        before = rows.G @ u
        out = (before > u_max + self._rounding) | (before < u_min - self._rounding)
        base = u
        if out.any():
            closing = self._ramp_down.limits(u, u_min, u_max)
            u_min, u_max = (side[0] * self._row_max + before for side in closing)
            lost = np.isin(rows.entry, rows.thruster[out])
            squares = np.bincount(rows.entry, (u / du_max) ** 2)
            back = 1.0 - 1.0 / np.sqrt(np.maximum(squares, 1.0))[rows.entry]
            base = np.where(lost, back * u, u)
        move = np.clip(du, -du_max, du_max)
        if self._turning is not None:
            move = self._turning.kept(u, move, du_max)
        target = u + move
        at_base, change = rows.G @ base, rows.G @ (target - base)
        room = np.where(change > 0.0, u_max - at_base, at_base - u_min)
        share = np.full(len(room), 1.0)
        over = np.abs(change) > np.maximum(room, 0.0) + self._rounding
        share[over] = np.maximum(room[over], 0.0) / np.abs(change[over])
        t = np.ones(int(rows.entry[-1]) + 1)
        np.minimum.at(t, rows.thruster, share)
        applied[...] = base + t[rows.entry] * (target - base)
        return bool((np.abs(applied - u - du) > CLIP_TOLERANCE * du_max).any())


class FallbackLaw:
    """What moves the ship when a solve left no usable answer.

    `shifted_plan` follows the last usable plan, one move further for every step since, and holds
    when it is used up; `hold` keeps the force; `clip` is the unconstrained law (eq. 33), which the
    loop clips. `acted` is whether the last move was one without an answer.
    """

    def __init__(self, kind: Fallback, builder: CondensedQP) -> None:
        problem = builder.control
        self.kind, self.acted = kind, False
        self._builder = builder
        self._plan: Matrix = np.zeros((problem.N_c, problem.model.n_u))
        self._age = problem.N_c
        self._known: tuple[CondensedMatrices, Gains] | None = None

    def remember(self, plan: Matrix) -> Vector:
        """Keep a usable plan (N_c, n_u) and return its first move."""
        self._plan, self._age, self.acted = plan, 0, False
        first: Vector = plan[0]
        return first

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Δu (n_u,) in place of the missing answer."""
        self.acted = True
        if self.kind == "clip":
            law = self._law(self._builder.matrices)
            move: Vector = law.K_y @ y_ref - law.K_mpc @ x
            return move if law.K_u is None else move - law.K_u @ u_prev
        self._age += 1
        if self.kind == "hold" or self._age >= len(self._plan):
            return np.zeros(self._plan.shape[1])
        next_move: Vector = self._plan[self._age]
        return next_move

    def _law(self, matrices: CondensedMatrices) -> Gains:
        """The gains that go with the builder's matrices, which may turn with the ship."""
        if self._known is None or self._known[0] is not matrices:
            self._known = matrices, gains(self._builder.control, matrices)
        return self._known[1]
