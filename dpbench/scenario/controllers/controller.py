"""The interface of controllers, which plan by a condensed QP; the thrusters that one commands."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.condensed_qp import Amplitude, CondensedQP
from dpbench.mpc.move_limits import MoveLimit, ThrusterLimit, make_increment_limiter
from dpbench.mpc.soft_limits import OutputBounds
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import Limits, ThrusterRows, build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningLimit
from dpbench.scenario.controllers.specification import ControllerSpec, Linearisation
from dpbench.ship.thrusters import ThrusterSet, Trips

Changes = tuple[tuple[int, Limits], ...]
"""(sample, limits) from which on these limits hold, in order of time."""
MetricGroup = Literal["axis_limits", "joint_limits", "thrusters", "delivery"]
"""Metrics that not every controller has: limits of each axis of the force, of the force as a whole,
of thrusters and their wear, and force demanded but not delivered."""


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


@dataclass(frozen=True, eq=False)
class Controller(ABC):
    """Configured controller of a ship: MPC problem, options, and changes of limits by faults.

    problem : model at psi0_rad, horizons, weights and limits in SI units.
    amplitude, outputs : policy of the amplitude limits; bounds on position and speed.
    changes : of the limits of u, by faults.
    """

    tuning: str
    problem: ControlProblem
    psi0_rad: float
    linearisation: Linearisation
    amplitude: Amplitude
    outputs: OutputBounds | None
    changes: Changes

    metric_groups: ClassVar[tuple[MetricGroup, ...]]
    """The metrics that apply besides those of every run."""
    allocates: ClassVar[bool] = False
    """True where the planned force is then allocated to thrusters."""
    commands: ClassVar[str] = ""
    """Suffix of the description: ", thrusters"; "" for forces."""
    why_no_delay: ClassVar[str] = ""
    """Reason why late answers on a slow computer are not simulated; "" where they are."""

    @property
    def tuning_and_horizons_label(self) -> str:
        """Controller tuning and horizons as text, e.g. "robust 60/10"."""
        return f"{self.tuning} {self.problem.N_p}/{self.problem.N_c}"

    @property
    def tuning_horizons_and_command_text(self) -> str:
        """Tuning, horizons and kind of command as text, e.g. "tuning robust 60/10, cascade"."""
        return f"tuning {self.tuning_and_horizons_label}{self.commands}"

    @property
    def commanded_thrusters(self) -> ThrusterControl | None:
        """Commanded thrusters; None where a force in surge, sway and yaw is commanded."""
        return None

    @property
    def thruster_force_count(self) -> int:
        """Number of commanded thruster force components; 0 where no thrusters are commanded."""
        return 0 if self.commanded_thrusters is None else self.commanded_thrusters.thrusters.n_f

    def make_condensed_qp_builder(self, units: UnitSystem = "scaled") -> CondensedQP:
        """Return the builder of this controller's condensed QPs, in scaled or SI units."""
        policy = {"amplitude": self.amplitude, "outputs": self.outputs}
        return self.linearisation.condense(self.problem, units=units, **policy)

    def make_sparse_qp_builder(self, units: UnitSystem, where: str) -> StagedQP:
        """Return the builder of the sparse QPs; InputError where there is no sparse form."""
        why = self.reason_for_no_sparse_form
        if why or self.amplitude == "soft":
            allowed = "a scenario without layers and with one model"
            raise InputError(where, "formulation", why, allowed)
        return StagedQP(self.problem, units=units, amplitude=self.amplitude)

    @property
    def reason_for_no_sparse_form(self) -> str:
        """Reason why the QPs have no sparse form; "" where they have one."""
        if self.linearisation.why_no_sparse_form:
            return self.linearisation.why_no_sparse_form
        if self.amplitude == "soft" or self.outputs is not None:
            return "sparse: soft limits and output bounds are layers on the condensed problem"
        return ""

    def make_allocation_qp_builder(self, units: UnitSystem = "scaled") -> AllocationQP | None:
        """Return the builder of the thrust-allocation QPs; None without such a second QP."""
        return None

    def make_increment_limiter(self) -> MoveLimit:
        """Return the limiter of control increments between the plan and the applied force."""
        return make_increment_limiter(self.problem)

    @property
    def limits_built_into_qp(self) -> Limits | None:
        """Limits that the QP builder already contains; None where limits change at each step."""
        return self.problem.limits

    def list_planned_force_limits_by_sample(self, samples: int) -> list[Limits]:
        """Return the limits of the planned force at each of `samples` samples, faults included."""
        return list_force_limits_by_sample(self.problem.limits, self.changes, samples)

    def list_thruster_limits_by_sample(self, samples: int) -> list[Limits]:
        """Return the limits of the commanded thrusters at each sample; [] without thrusters."""
        return []

    @abstractmethod
    def convert_commands_to_ship_force(self, u: Matrix) -> Matrix:
        """Return the force on the ship (..., 3) for commands u (..., n_u)."""

    @abstractmethod
    def select_applied_commands(self, tau: Matrix, thrust: Matrix) -> Matrix:
        """Return the applied commands (K, n_u): the forces tau (K, 3) or thrust (K, n_f)."""

    def adapt_to_baseline_law(self) -> "Controller":
        """Return this controller for the unconstrained law, without a thrust-allocation QP."""
        return self


def list_force_limits_by_sample(own: Limits, changes: Changes, samples: int) -> list[Limits]:
    """Return force limits at each sample: `own` before the first fault, then the changed ones."""
    limits = [own] * samples
    for k, changed in changes:
        limits[k:] = [changed] * len(limits[k:])
    return limits


def stack_lower_and_upper_limits(limits: Iterable[Limits]) -> tuple[Matrix, Matrix]:
    """Return lower and upper limits (K, r) of K samples as arrays."""
    low, high, _ = zip(*limits, strict=True)
    return np.array(low), np.array(high)
