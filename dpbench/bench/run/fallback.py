"""From an answer, or the lack of one, to the force that is applied (method.md section 3)."""

from __future__ import annotations

from functools import partial
from typing import Protocol

import numpy as np
from numba import njit

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import Fallback
from dpbench.mpc.condense import CondensedMatrices, ControlProblem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import Gains, gains
from dpbench.mpc.thruster_rows import RETREAT

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


def limit_of(problem: ControlProblem) -> Limit:
    """How the moves of a controller are limited: forces axis by axis, thrusters each as a whole."""
    if problem.thrusters is None:
        return partial(limit_move, problem.du_max)
    rows = problem.thrusters
    return partial(limit_thrusters, problem.du_max, rows.G, rows.thruster, rows.entry)


@njit(cache=True)
def limit_move(du_max, u, du, u_min, u_max, applied):  # type: ignore[no-untyped-def] # numba
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


@njit(cache=True)
def limit_thrusters(  # type: ignore[no-untyped-def] # numba
    df_max, G, row_of, entry_of, f, df, low, high, applied
):
    """The same for thrusters, each with rows of its own (`thruster_rows`).

        applied = b + t (f + clip(Δf, ±Δf_max) − b),   largest t ≤ 1 within low ≤ G · ≤ high

    b is the force before or, where that is beyond a limit by now, one step of the straight retreat
    to nothing (`Retreat`); b and the clipped move keep to the rate, so all between them do.
    """
    r, n_f = G.shape
    clipped = False
    base, target = np.empty(n_f), np.empty(n_f)
    for j in range(n_f):
        base[j] = f[j]
        target[j] = f[j] + min(max(df[j], -df_max[j]), df_max[j])
    for i in range(entry_of[-1] + 1):
        outside, steps, rounding = False, 0.0, 0.0
        for k in range(r):
            if row_of[k] == i:
                before = 0.0
                for j in range(n_f):
                    before += G[k, j] * f[j]
                outside |= before > high[k] or before < low[k]
        for j in range(n_f):
            if entry_of[j] == i:
                steps = max(steps, abs(f[j]) / df_max[j])
                rounding = max(rounding, CLIP_TOLERANCE * df_max[j])
        if outside and steps > 0.0:
            for j in range(n_f):
                if entry_of[j] == i:
                    base[j] = f[j] * max(0.0, 1.0 - RETREAT / steps)
        t = 1.0
        for k in range(r):
            if row_of[k] == i:
                at_base, at_target = 0.0, 0.0
                for j in range(n_f):
                    at_base += G[k, j] * base[j]
                    at_target += G[k, j] * target[j]
                most, least = max(high[k], at_base), min(low[k], at_base)
                if at_target > most + rounding:
                    t = min(t, (most - at_base) / (at_target - at_base))
                elif at_target < least - rounding:
                    t = min(t, (least - at_base) / (at_target - at_base))
        for j in range(n_f):
            if entry_of[j] == i:
                applied[j] = base[j] + t * (target[j] - base[j]) if t < 1.0 else target[j]
                if abs(applied[j] - f[j] - df[j]) > CLIP_TOLERANCE * df_max[j]:
                    clipped = True
    return clipped


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
