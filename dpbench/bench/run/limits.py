"""From a move to the force that is applied within all limits (method.md section 3)."""

from __future__ import annotations

from functools import partial
from typing import Protocol

import numpy as np

from dpbench.arrays import Vector
from dpbench.kernel_cache import njit
from dpbench.mpc.condensed_qp import CondensedQP
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
