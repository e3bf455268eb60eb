"""The thrusters that a controller commands: their limits, their weight, their turning rates."""

from dataclasses import dataclass, field

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.move_limits import MoveLimit, ThrusterLimit
from dpbench.mpc.thruster_rows import ThrusterRows, build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningLimit
from dpbench.scenario.controllers.specification import ControllerSpec
from dpbench.ship.thrusters import ThrusterSet, Trips


@dataclass(frozen=True, eq=False)
class ThrusterControl:
    """Thrusters that a controller commands, with their limits and their force weight W.

    trips : thrusters that stop at once; their force before that step's move is zero.
    """

    thrusters: ThrusterSet
    rows: ThrusterRows
    W: Matrix
    trips: Trips = field(default=(), kw_only=True)

    def get_force_before_step(self, f: Matrix, k: int) -> Vector:
        """Return the force (n_f,) before the move of step k: zero at first, and where one trips."""
        before: Vector = f[k - 1].copy() if k else np.zeros(f.shape[1])
        for sample, entries in self.trips:
            if sample == k:
                before[entries] = 0.0
        return before

    def make_increment_limiter(self, df_max: Vector) -> MoveLimit:
        """Return the limiter of force changes, with the rate limits df_max (n_f,) [N]."""
        return ThrusterLimit(self.rows, df_max)

    def exceeds_rate_limits(self, f: Matrix, before: Matrix, df_max: Vector) -> Flags:
        """Return for K samples whether thruster forces change faster than their limits: (K,)."""
        too_fast: Flags = np.any(np.abs(f - before) > df_max * (1.0 + 1e-12), axis=1)
        return too_fast


@dataclass(frozen=True, eq=False)
class TurningThrusterControl(ThrusterControl):
    """Commanded thrusters whose azimuths have a limited turning rate."""

    turning: AzimuthTurning

    def make_increment_limiter(self, df_max: Vector) -> MoveLimit:
        """Return the limiter of force changes, for thrust rate and turning rate of azimuths."""
        return TurningLimit(self.rows, df_max, self.turning)

    def exceeds_rate_limits(self, f: Matrix, before: Matrix, df_max: Vector) -> Flags:
        """Return for K samples whether forces exceed the limits of thrust or turning rate: (K,)."""
        too_fast = super().exceeds_rate_limits(f, before, df_max)
        for k in np.flatnonzero(~too_fast).tolist():
            change = f[k] - before[k]
            away = np.abs(
                self.turning.clip_force_changes_to_rates(before[k], change, df_max) - change
            )
            too_fast[k] = bool((away > 1e-6 * df_max).any())
        return too_fast


def build_commanded_thrusters(spec: ControllerSpec) -> ThrusterControl:
    """Build a controller's commanded thrusters; InputError without any, or for wrong turning."""
    table, where = spec.thruster_table, spec.where
    thrusters = spec.require_thrusters_for_key("kind", spec.controller_table.kind, "forces")
    W = np.diag(
        table.thrust_weight_relative
        / thrusters.repeat_for_each_force_entry(thrusters.largest_thrusts_N) ** 2
    )
    rows = build_limit_rows_of_thrusters(thrusters, table.polygon_sides)
    if not table.azimuth_turning:
        return ThrusterControl(thrusters, rows, W, trips=spec.samples_and_entries_of_trips)
    key = "controller.thrusters.azimuth_turning"
    if spec.controller_table.linearisation == "each_step":
        allowed = 'false where controller.linearisation is "each_step"'
        raise InputError(where, key, "true", allowed)
    turning = AzimuthTurning.select_from_thrusters(thrusters, spec.sample_s)
    if not len(turning.x):
        allowed = f"false, or turning_degps of an azimuth in the file of vessel {spec.vessel.id}"
        raise InputError(where, key, "true", allowed)
    return TurningThrusterControl(
        thrusters, rows, W, turning, trips=spec.samples_and_entries_of_trips
    )
