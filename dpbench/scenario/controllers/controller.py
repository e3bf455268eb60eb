"""The interface of controllers, which plan by a condensed QP, and the tables they are made from.

Also the thrusters that a controller commands.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar, Literal, TypedDict

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.errors import InputError, format_key_path
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.condensed_qp import Amplitude, CondensedQP
from dpbench.mpc.model import StateSpace, build_prediction_model
from dpbench.mpc.move_limits import MoveLimit, ThrusterLimit, make_increment_limiter
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.soft_limits import OutputBounds
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import Limits, ThrusterRows, build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningLimit, TurningQP
from dpbench.scenario.tables.scenario_file import (
    ControllerTable,
    FaultTable,
    ScenarioFile,
    ThrusterControlTable,
)
from dpbench.ship.froude import Froude
from dpbench.ship.thrusters import ThrusterSet, Trips
from dpbench.ship.vessel import Vessel


@dataclass(frozen=True)
class Linearisation:
    """Factory of condensed QPs, with arguments of `CondensedQP`, for one linearisation."""

    condense: Callable[..., CondensedQP]
    why_no_sparse_form: str = ""


FIXED_MODEL = Linearisation(CondensedQP)  # One model for the whole run


def make_factory_of_relinearised_qps(psi0_rad: float) -> Linearisation:
    """Return the factory of QPs that are re-linearised at each measured heading."""
    why = "sparse: the model is linearised again at each step, so its stages change"
    return Linearisation(partial(RelinearisedQP, psi0_rad=psi0_rad), why)


def make_factory_of_turning_limited_qps(turning: AzimuthTurning) -> Linearisation:
    """Return a maker of MPC QPs that limit how fast azimuth thrusters turn."""
    why = "sparse: the directions of azimuths, and so some rows, change at each step"
    return Linearisation(partial(TurningQP, turning=turning), why)


class Planning(TypedDict):
    """Planning settings of a controller: tuning, linearisation, limit policy, output bounds."""

    tuning: str
    psi0_rad: float
    linearisation: Linearisation
    amplitude: Amplitude
    outputs: OutputBounds | None


@dataclass(frozen=True, eq=False)
class ControllerSpec:
    """Scenario file, ship and scaling from which a controller is built."""

    file: ScenarioFile
    vessel: Vessel
    sample_s: float
    scale: Froude
    where: str

    @property
    def controller_table(self) -> ControllerTable:
        """Controller settings of the scenario file."""
        return self.file.controller

    @property
    def thruster_table(self) -> ThrusterControlTable:
        """Settings of the commanded thrusters in the scenario file."""
        assert self.controller_table.thrusters is not None, "the table demands it"
        return self.controller_table.thrusters

    @property
    def planning_settings(self) -> Planning:
        """Controller settings for planning: tuning, linearisation, limit policy, output bounds."""
        table, psi0_rad = self.controller_table, self._linearisation_heading_rad
        each_step = table.linearisation == "each_step"
        return {
            "tuning": table.tuning,
            "psi0_rad": psi0_rad,
            "linearisation": make_factory_of_relinearised_qps(psi0_rad)
            if each_step
            else FIXED_MODEL,
            "amplitude": table.amplitude,
            "outputs": self._output_bounds_in_si,
        }

    def build_control_problem(
        self,
        limits: Limits,
        du_max: Vector,
        R: Matrix,
        *,
        rows: ThrusterRows | None = None,
        T_e: Matrix | None = None,
        W: Matrix | None = None,
    ) -> ControlProblem:
        """Return the MPC problem with given limits and increment weights R, in SI units."""
        ship, table, psi0_rad = self.vessel, self.controller_table, self._linearisation_heading_rad
        model = build_prediction_model(ship.M, ship.D, psi0_rad, self.sample_s)
        if T_e is not None:
            model = StateSpace(model.A, model.B @ T_e, model.C)
        horizons = table.prediction_horizon, table.control_horizon
        Q = np.diag(np.array(table.output_weight) / self.scale.pose_factors**2)
        sides = limits.low, limits.high, du_max
        return ControlProblem(model, *horizons, Q, R, *sides, table.terminal, rows, W)

    @property
    def _linearisation_heading_rad(self) -> float:
        """Heading [rad] at which the controller's model is linearised."""
        return float(np.radians(self.controller_table.model_heading_deg))

    @property
    def _output_bounds_in_si(self) -> OutputBounds | None:
        """Bounds on predicted position and speed, in SI units; None without any."""
        table = self.controller_table.outputs
        if table is None:
            return None
        return OutputBounds(
            self.sample_s,
            None if table.radius_m is None else table.radius_m * self.scale.length_factor,
            None if table.speed_mps is None else table.speed_mps * self.scale.time_and_speed_factor,
        )

    def require_thrusters_for_key(self, key: str, value: str, otherwise: str) -> ThrusterSet:
        """Return the vessel's thrusters; InputError if a key needs them and there are none."""
        if self.vessel.thrusters is None:
            allowed = f'"{otherwise}" for vessel {self.vessel.id}, as its file has no [[thrusters]]'
            raise InputError(self.where, f"controller.{key}", f'"{value}"', allowed)
        return self.vessel.thrusters

    def refuse_unsupported_faults(self, *, lost: bool, limit_share: bool) -> None:
        """Raise InputError for a kind of fault that the controller cannot have."""
        for _, i, fault in self._samples_and_faults_in_order:
            if not (lost if fault.lost is not None else limit_share):
                found, allowed = (
                    ("key lost", "key limit_share, as the controller has no thrusters to lose")
                    if fault.lost is not None
                    else ("key limit_share", "key lost, as the controller's limits are thrusters'")
                )
                raise InputError(
                    self.where, format_key_path(["faults", i], is_table=True), found, allowed
                )

    @property
    def samples_and_shares_of_limit_faults(self) -> list[tuple[int, Vector]]:
        """Sample and remaining share (3,) of the force limits, for each fault that reduces them."""
        shares = [(k, fault.limit_share) for k, _, fault in self._samples_and_faults_in_order]
        return [(k, np.array(share)) for k, share in shares if share is not None]

    @property
    def samples_and_lost_thrusters_of_faults(self) -> list[tuple[int, set[int]]]:
        """Sample and indices of all thrusters lost so far, for each fault that loses thrusters."""
        losses: list[tuple[int, set[int]]] = []
        lost: set[int] = set()
        for k, i, fault in self._samples_and_faults_in_order:
            if fault.lost is not None:
                assert self.vessel.thrusters is not None, "known by now"
                key = format_key_path(["faults", i, "lost"])
                lost = lost | self.vessel.thrusters.find_indices_of_thrusters_or_groups(
                    fault.lost, self.where, key
                )
                losses.append((k, lost))
        return losses

    @property
    def samples_and_entries_of_trips(self) -> Trips:
        """Sample and entries of f of the thrusters that stop at once, for each such fault."""
        thrusters, trips = self.vessel.thrusters, []
        for k, i, fault in self._samples_and_faults_in_order:
            if fault.loss == "trip" and fault.lost is not None and thrusters is not None:
                lost = thrusters.find_indices_of_thrusters_or_groups(
                    fault.lost, self.where, format_key_path(["faults", i, "lost"])
                )
                trips.append((k, thrusters.find_force_entries_of_thrusters(lost)))
        return tuple(trips)

    def refuse_instant_thruster_stops(self) -> None:
        """Raise InputError for a fault that stops thrusters at once, as none are commanded."""
        for _, i, fault in self._samples_and_faults_in_order:
            if fault.loss == "trip":
                allowed = '"ramp_down", or "trip" where the controller commands the thrusters'
                raise InputError(
                    self.where, format_key_path(["faults", i, "loss"]), '"trip"', allowed
                )

    @property
    def _samples_and_faults_in_order(self) -> list[tuple[int, int, FaultTable]]:
        """Sample, index in the file and settings of each fault, in order of time."""
        in_time = sorted(enumerate(self.file.faults), key=lambda entry: entry[1].at_s)
        return [(round(fault.at_s / self.file.sample_s), i, fault) for i, fault in in_time]


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
    """Return a controller's commanded thrusters; InputError without any, or for wrong turning."""
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
        allowed = (
            "false; true needs turning_degps for an azimuth thruster in the file of vessel "
            f"{spec.vessel.id}"
        )
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
        why = self.reason_for_no_sparse_form.removeprefix("sparse: ")
        if why or self.amplitude == "soft":
            allowed = f"'condensed_box' or 'condensed_stacked', as {why}; or 'sparse' for a "
            allowed += (
                'scenario with one model, amplitude = "hard" or "reachable", and no output bounds'
            )
            raise InputError(where, "formulation", "'sparse'", allowed)
        return StagedQP(self.problem, units=units, amplitude=self.amplitude)

    @property
    def reason_for_no_sparse_form(self) -> str:
        """Reason why the QPs have no sparse form; "" where they have one."""
        if self.linearisation.why_no_sparse_form:
            return self.linearisation.why_no_sparse_form
        if self.amplitude == "soft" or self.outputs is not None:
            return "sparse: soft limits and output bounds exist in the condensed form only"
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
