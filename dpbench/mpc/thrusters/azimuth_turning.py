"""Azimuths that turn at a limited rate: rows on the moves of their forces, anew at every step.

    n = f/|f|,  t across it:    |n·Δf_i| ≤ Δf_max,    |t·Δf_i| ≤ max(|f|, 0.05 T) ω ΔT

for the force f of a thruster before the step, at every move i: the turning rate ω bounds the part
of a move across the direction by the arc it sweeps, the thrust rate the part along it. The
direction is that of the step, so A changes with it. A thruster with hardly any force is turned as
with a twentieth of its thrust; else it could never leave zero but ahead.
"""

from dataclasses import dataclass
from typing import Unpack

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.condensed_qp import CondensedOptions, CondensedQP
from dpbench.mpc.move_limits import ThrusterLimit
from dpbench.mpc.soft_limits import ConstraintBlock
from dpbench.mpc.thruster_rows import Limits, ThrusterRows
from dpbench.qp.program import QPStep
from dpbench.ship.thrusters import ThrusterSet

LEAST = 0.05  # Share of its thrust that an azimuth which hardly pushes is turned as if it had


@dataclass(frozen=True, eq=False)
class AzimuthTurning:
    """Turning limits of a ship's azimuth thrusters with a known turning rate.

    x : (a,) index of X of each in f; Y is behind it. arc : (a,) ω ΔT [rad], the turn in a sample;
    least_N : (a,) 0.05 T [N].
    """

    x: np.ndarray
    arc: Vector
    least_N: Vector

    @classmethod
    def select_from_thrusters(cls, thrusters: ThrusterSet, sample_s: float) -> "AzimuthTurning":
        """Select the thrusters of a ship that have a known turning rate."""
        pairs = zip(thrusters.thrusters, thrusters.slices_in_force_vector, strict=True)
        turning = [(t, at) for t, at in pairs if t.turning_radps is not None]
        rates = [t.turning_radps or 0.0 for t, _ in turning]
        return cls(
            np.array([at.start for _, at in turning], dtype=np.intp),
            np.array(rates) * sample_s,
            np.array([LEAST * t.thrust_N for t, _ in turning]),
        )

    def force_directions_and_side_limits(self, f: Vector) -> tuple[Vector, Vector, Vector]:
        """Return each azimuth's direction (cos, sin) and largest sideways change per sample [N]."""
        parts = zip(f[self.x], f[self.x + 1], self.arc, self.least_N, strict=True)
        c, s, most = (
            np.array([_force_direction_and_side_limit(*part) for part in parts]).reshape(-1, 3).T
        )
        return c, s, most

    def clip_force_changes_to_rates(self, f: Vector, move: Vector, du_max: Vector) -> Vector:
        """Return the force changes (n_f,) cut to the limits of thrust rate and turning rate."""
        c, s, most = self.force_directions_and_side_limits(f)
        x, y, unit = move[self.x], move[self.x + 1], du_max[self.x]
        radial = np.clip(c * x + s * y, -unit, unit)
        tangential = np.clip(c * y - s * x, -most, most)
        out = move.copy()
        out[self.x], out[self.x + 1] = c * radial - s * tangential, s * radial + c * tangential
        # Turned back, a part may exceed the rate of its entry: shorter as a whole it does not.
        longest = np.maximum(np.abs(out[self.x]), np.abs(out[self.x + 1])) / unit
        shorter = 1.0 / np.maximum(longest, 1.0)
        out[self.x] *= shorter
        out[self.x + 1] *= shorter
        return out


class TurningLimit(ThrusterLimit):
    """Limiter of thruster force changes that also limits the turning rate of azimuths."""

    def __init__(self, rows: ThrusterRows, du_max: Vector, turning: AzimuthTurning) -> None:
        super().__init__(rows, du_max)
        self._turning = turning

    def _clip_to_force_rate(self, u: Vector, du: Vector) -> Vector:
        """Return the force changes du (n_f,) cut to the limits of thrust rate and turning rate."""
        return self._turning.clip_force_changes_to_rates(
            u, super()._clip_to_force_rate(u, du), self._du_max
        )


@njit(cache=True, error_model="numpy")
def _force_direction_and_side_limit(along, across, arc, least_N):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Return an azimuth's force direction (cos, sin) and its largest sideways force change [N]."""
    size = np.sqrt(along * along + across * across)
    most = max(size, least_N) * arc
    # Below it a direction is rounding, and what is squared is lost.
    return (along / size, across / size, most) if size > 1e-9 * least_N else (1.0, 0.0, most)


class TurningQP(CondensedQP):
    """Builder of the condensed QP for azimuths with a limited turning rate; A changes each step.

    Arguments as for `CondensedQP`, of thrusters; turning : the azimuths, also an attribute.
    """

    def __init__(
        self, problem: ControlProblem, turning: AzimuthTurning, **form: Unpack[CondensedOptions]
    ) -> None:
        self.turning = turning
        super().__init__(problem, **form)
        a, rows = len(turning.x), self.m // problem.N_c
        unit = problem.du_max[turning.x] if self.units == "scaled" else np.ones(a)
        # One array, because most of the time of a call goes to its arguments.
        limits = turning.arc, turning.least_N, problem.du_max[turning.x] / unit, unit
        first = rows - 2 * a + 2 * np.arange(a)
        self._table: Matrix = np.vstack([turning.x, *limits, first]).astype(np.float64)

    def _list_extra_constraint_blocks(self) -> list[ConstraintBlock]:
        """Return two constraints per azimuth on force change along and across it at zero force."""
        problem, turning = self.control, self.turning
        N_c, n_u, a = problem.N_c, problem.model.n_u, len(turning.x)
        moves = np.zeros((N_c, 2 * a, N_c, n_u))
        for i in range(N_c):
            moves[i, np.arange(0, 2 * a, 2), i, turning.x] = 1.0
            moves[i, np.arange(1, 2 * a, 2), i, turning.x + 1] = 1.0
        unit = np.repeat(problem.du_max[turning.x], 2)
        high = np.zeros((N_c, 2 * a, problem.model.theta.size))
        high[:, 0::2, -1], high[:, 1::2, -1] = 1.0, turning.least_N * turning.arc / unit[::2]
        rows, nothing = moves.reshape(N_c, 2 * a, -1), np.zeros(0)
        return [ConstraintBlock(rows, np.zeros((2 * a, 0)), -high, high, unit, nothing, nothing)]

    def emit(
        self, x: Vector, y_ref: Vector, u_prev: Vector, *, limits: Limits | None = None
    ) -> QPStep:
        """Return one step's QP, with azimuth turning constraints set by the last forces."""
        step = super().emit(x, y_ref, u_prev, limits=limits)
        A: Matrix = self.A.copy()
        _write_turning_constraint_matrix(self._table, u_prev, A, step.l, step.u, self.control.N_c)
        step.A = A
        return step


# Rows of the table of `_write_turning_constraint_matrix`, a column an azimuth;
# FIRST is the first of its rows.
X, ARC, LEAST_N, RADIAL, UNIT, FIRST = range(6)


@njit(cache=True, error_model="numpy")
def _write_turning_constraint_matrix(table, f, A, l, u, N_c):  # type: ignore[no-untyped-def] # noqa: E741 - compiled: numba finds the types; of l ≤ Az ≤ u
    """Write the rows that limit each azimuth's force change along and across its direction."""
    rows, block = A.shape[0] // N_c, A.shape[1] // N_c
    for j in range(table.shape[1]):
        at, radial = int(table[X, j]), table[RADIAL, j]
        c, s, most = _force_direction_and_side_limit(
            f[at], f[at + 1], table[ARC, j], table[LEAST_N, j]
        )
        across = most / table[UNIT, j]
        for i in range(N_c):
            r, x = i * rows + int(table[FIRST, j]), i * block + at
            A[r, x], A[r, x + 1] = c, s
            A[r + 1, x], A[r + 1, x + 1] = -s, c
            l[r], u[r], l[r + 1], u[r + 1] = -radial, radial, -across, across
