"""Tables and ship that a controller is made from, and what all controllers take from them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypedDict

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.condensed_qp import Amplitude, CondensedQP
from dpbench.mpc.model import StateSpace, build_prediction_model
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.soft_limits import OutputBounds
from dpbench.mpc.thruster_rows import Limits, ThrusterRows
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningQP
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
    why = "sparse: the model is linearised anew at each step, and its stages with it"
    return Linearisation(partial(RelinearisedQP, psi0_rad=psi0_rad), why)


def make_factory_of_turning_limited_qps(turning: AzimuthTurning) -> Linearisation:
    """Return a maker of MPC QPs that limit how fast azimuth thrusters turn."""
    why = "sparse: the directions of azimuths are other ones at each step, and so are rows"
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
            allowed = f'"{otherwise}", or thrusters in the file of vessel {self.vessel.id}'
            raise InputError(self.where, f"controller.{key}", f'"{value}"', allowed)
        return self.vessel.thrusters

    def refuse_unsupported_faults(self, *, lost: bool, limit_share: bool) -> None:
        """Raise InputError for a kind of fault that the controller cannot have."""
        for i, (_, fault) in enumerate(self._samples_and_faults_in_order):
            if not (lost if fault.lost is not None else limit_share):
                found = "lost" if fault.lost is not None else "limit_share"
                allowed = (
                    "lost where thrusters limit the force or are commanded, limit_share where each "
                    "axis of the force has a limit of its own"
                )
                raise InputError(self.where, f"faults.{i}", found, allowed)

    @property
    def samples_and_shares_of_limit_faults(self) -> list[tuple[int, Vector]]:
        """Sample and remaining share (3,) of the force limits, for each fault that reduces them."""
        shares = [(k, fault.limit_share) for k, fault in self._samples_and_faults_in_order]
        return [(k, np.array(share)) for k, share in shares if share is not None]

    @property
    def samples_and_lost_thrusters_of_faults(self) -> list[tuple[int, set[int]]]:
        """Sample and indices of all thrusters lost so far, for each fault that loses thrusters."""
        losses: list[tuple[int, set[int]]] = []
        lost: set[int] = set()
        for i, (k, fault) in enumerate(self._samples_and_faults_in_order):
            if fault.lost is not None:
                assert self.vessel.thrusters is not None, "known by now"
                key = f"faults.{i}.lost"
                lost = lost | self.vessel.thrusters.find_indices_of_thrusters_or_groups(
                    fault.lost, self.where, key
                )
                losses.append((k, lost))
        return losses

    @property
    def samples_and_entries_of_trips(self) -> Trips:
        """Sample and entries of f of the thrusters that stop at once, for each such fault."""
        thrusters, trips = self.vessel.thrusters, []
        for i, (k, fault) in enumerate(self._samples_and_faults_in_order):
            if fault.loss == "trip" and fault.lost is not None and thrusters is not None:
                lost = thrusters.find_indices_of_thrusters_or_groups(
                    fault.lost, self.where, f"faults.{i}.lost"
                )
                trips.append((k, thrusters.find_force_entries_of_thrusters(lost)))
        return tuple(trips)

    def refuse_instant_thruster_stops(self) -> None:
        """Raise InputError for a fault that stops thrusters at once, as none are commanded."""
        for i, (_, fault) in enumerate(self._samples_and_faults_in_order):
            if fault.loss == "trip":
                allowed = '"ramp_down", or "trip" where thrusters are commanded'
                raise InputError(self.where, f"faults.{i}.loss", '"trip"', allowed)

    @property
    def _samples_and_faults_in_order(self) -> list[tuple[int, FaultTable]]:
        """Sample and settings of each fault, in order of time."""
        in_time = sorted(self.file.faults, key=lambda fault: fault.at_s)
        return [(round(fault.at_s / self.file.sample_s), fault) for fault in in_time]
