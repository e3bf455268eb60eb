"""Limits of rate and amplitude between a planned move and the applied force (method.md 3)."""

from typing import Protocol

import numpy as np

from dpbench.arrays import Vector
from dpbench.kernel_cache import njit
from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.thruster_rows import LimitRampDown, Limits, ThrusterRows

CLIP_TOLERANCE = 1e-9
"""Largest violation of a limit that counts as rounding, in maximum increments; above it
`clipped` is recorded."""
SMALL_VIOLATION = 1e-2
"""Largest violation that a change across the limit removes, in maximum increments: the largest
error of an accurate first move."""
MOST_SWEEPS = 50
"""Passes over all limits; a violation that is left shortens the move, as a larger one does."""


class MoveLimit(Protocol):
    """Function that limits a move du (n_u,) from u (n_u,), the force applied before."""

    def __call__(self, u: Vector, du: Vector, limits: Limits, applied: Vector) -> bool:
        """Write the rate- and amplitude-limited force to `applied`; return whether it was cut."""


def make_increment_limiter(problem: ControlProblem) -> MoveLimit:
    """Return the limiter of control increments: axis by axis, or each thruster as a whole."""
    if problem.thrusters is None:
        return AxisLimit(problem.du_max)
    return ThrusterLimit(problem.thrusters, problem.du_max)


class AxisLimit:
    """Limiter that clips each axis of the force by itself to its rate and amplitude limits."""

    def __init__(self, du_max: Vector) -> None:
        self._du_max = du_max

    def __call__(self, u: Vector, du: Vector, limits: Limits, applied: Vector) -> bool:
        """Clip an increment axis by axis; write the applied force, return whether it was cut."""
        clipped: bool = write_limited_command(self._du_max, u, du, limits.low, limits.high, applied)
        return clipped


@njit(cache=True)
def write_limited_command(du_max, u, du, u_min, u_max, applied):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write u + Δu, clipped to rate and amplitude limits, to `applied`; return whether it was cut.

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
    """Limiter that shortens the force change of each thruster as a whole.

        applied = b + t (f + clip(Δf, ±Δf_max) − b),   largest t ≤ 1 within low ≤ G · ≤ high

    b is the force before or, where that is beyond a limit by now, the first step of its way back to
    zero (`LimitRampDown`); b and the clipped move keep to the rate, so all between them do.

    Small violations are removed first, across the limits: if b is at a limit, a move along it with
    a small error outwards has t near 0, and the thrusters would stand still.
    """

    def __init__(self, rows: ThrusterRows, du_max: Vector) -> None:
        self._rows, self._du_max = rows, du_max
        self._row_max = rows.largest_row_changes_per_step(du_max)
        self._ramp_down = LimitRampDown(rows, du_max, self._row_max, 1)
        self._rounding = CLIP_TOLERANCE * self._row_max
        self._largest_removed = SMALL_VIOLATION * self._row_max

    def __call__(self, u: Vector, du: Vector, limits: Limits, applied: Vector) -> bool:
        """Shorten thrusters' force changes; write applied forces, return whether any was cut."""
        rows, du_max = self._rows, self._du_max
        before = rows.G @ u
        u_min, u_max, _ = limits
        out = (before > u_max + self._rounding) | (before < u_min - self._rounding)
        base = u
        if out.any():
            closing = self._ramp_down.compute_gradually_tightened_limits(u, limits)
            u_min, u_max = (side[0] * self._row_max + before for side in closing)
            beyond = np.isin(rows.entry, rows.thruster[out])
            squares = np.bincount(rows.entry, (u / du_max) ** 2)
            back = 1.0 - 1.0 / np.sqrt(np.maximum(squares, 1.0))[rows.entry]
            base = np.where(beyond, back * u, u)
        target = u + self._clip_to_force_rate(u, du)
        if remove_small_violations(
            rows.G, u_min, u_max, self._rounding, self._largest_removed, u, du_max, target
        ):
            target = u + self._clip_to_force_rate(u, target - u)
        at_base, change = rows.G @ base, rows.G @ (target - base)
        room = np.where(change > 0.0, u_max - at_base, at_base - u_min)
        share = np.full(len(room), 1.0)
        over = np.abs(change) > np.maximum(room, 0.0) + self._rounding
        share[over] = np.maximum(room[over], 0.0) / np.abs(change[over])
        t = np.ones(int(rows.entry[-1]) + 1)
        np.minimum.at(t, rows.thruster, share)
        applied[...] = base + t[rows.entry] * (target - base)
        return bool((np.abs(applied - u - du) > CLIP_TOLERANCE * du_max).any())

    def _clip_to_force_rate(self, u: Vector, du: Vector) -> Vector:
        """Return the force changes du (n_f,) clipped to the rate limits."""
        return np.clip(du, -self._du_max, self._du_max)


@njit(cache=True)
def remove_small_violations(G, low, high, rounding, most, before, du_max, force):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Move a force (n_f,) onto the limits low ≤ G f ≤ high (r,) that it violates by at most `most`.

    Row after row, and to within du_max (n_f,) of the force before, until all such rows are kept to
    within `rounding` (r,): cyclic projection (Bregman 1965), in multiples of du_max. Return whether
    the force was changed.
    """
    changed = False
    for _ in range(MOST_SWEEPS):
        moved = False
        for i in range(G.shape[0]):
            value, size = 0.0, 0.0
            for j in range(force.shape[0]):
                value += G[i, j] * force[j]
                size += (G[i, j] * du_max[j]) ** 2
            beyond = max(value - high[i], 0.0) - max(low[i] - value, 0.0)
            if rounding[i] < abs(beyond) <= most[i] and size > 0.0:
                for j in range(force.shape[0]):
                    force[j] -= beyond * G[i, j] * du_max[j] ** 2 / size
                moved = changed = True
        if not moved:
            break
        for j in range(force.shape[0]):
            force[j] = min(max(force[j], before[j] - du_max[j]), before[j] + du_max[j])
    return changed
