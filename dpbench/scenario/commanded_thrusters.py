"""What a scenario says of thrusters: who commands them, what limits their force, what is lost."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.thruster_rows import ThrusterRows, thruster_rows
from dpbench.mpc.thrusters.allocation_qp import AllocationProblem
from dpbench.mpc.thrusters.attainable_set import AttainableSet, attainable_set
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning
from dpbench.scenario.tables.scenario_file import ControllerTable, FaultTable, ScenarioFile
from dpbench.ship.actuators import Actuators, CommandedThrusters
from dpbench.ship.froude import Froude
from dpbench.ship.thrusters import ThrusterSet
from dpbench.ship.vessel import Vessel


@dataclass(frozen=True, eq=False)
class ThrusterControl:
    """What a controller that steers thrusters makes of them.

    thrusters : of the vessel; rows : their limits as the QP has them; W (n_f, n_f) : their weight.
    turning : azimuths whose turning rate the controller keeps to; None for none.
    """

    thrusters: ThrusterSet
    rows: ThrusterRows
    W: Matrix
    turning: AzimuthTurning | None = None


@dataclass(frozen=True, eq=False)
class Allocation:
    """How a cascade makes its force by thrusters.

    control : thrusters, their rows and weight; problem : what the QP weighs and may do.
    by_qp : whether a QP allocates, or the pseudo-inverse.
    faults : (sample, least, most, lost) from which on these limits of the rows (r,) hold and the
        thrusters of these numbers give nothing, in order of time.
    """

    control: ThrusterControl
    problem: AllocationProblem
    by_qp: bool
    faults: tuple[tuple[int, Vector, Vector, frozenset[int]], ...]

    def limit_tables(self, samples: int) -> tuple[Matrix, Matrix]:
        """The limits of the rows in force at each sample (samples, r)."""
        return limit_tables_of(
            (self.control.rows.low, self.control.rows.high),
            [(k, least, most) for k, least, most, _ in self.faults],
            samples,
        )


def limit_tables_of(
    own: tuple[Vector, Vector], faults: Iterable[tuple[int, Vector, Vector]], samples: int
) -> tuple[Matrix, Matrix]:
    """Limits (samples, r) that are `own` until a fault, and its from then on."""
    low, high = (np.tile(limit, (samples, 1)) for limit in own)
    for k, least, most in faults:
        low[k:], high[k:] = least, most
    return low, high


def thruster_control(
    controller: ControllerTable, vessel: Vessel, sample_s: float, where: str
) -> ThrusterControl | None:
    """The thrusters that the controller commands; InputError where the vessel has none."""
    table = controller.thrusters
    if table is None:
        return None
    if vessel.thrusters is None:
        allowed = f'"forces", or thrusters in the file of vessel {vessel.id}'
        raise InputError(where, "controller.kind", f'"{controller.kind}"', allowed)
    thrusters = vessel.thrusters
    W = table.thrust_weight_relative / thrusters.per_entry(thrusters.thrust_N) ** 2
    rows = thruster_rows(thrusters, table.polygon_sides)
    if not table.azimuth_turning:
        return ThrusterControl(thrusters, rows, np.diag(W))
    if controller.linearisation == "each_step":
        allowed = 'false where controller.linearisation is "each_step"'
        raise InputError(where, "controller.thrusters.azimuth_turning", "true", allowed)
    turning = AzimuthTurning.of(thrusters, sample_s)
    if not len(turning.x):
        allowed = f"false, or turning_degps of an azimuth in the file of vessel {vessel.id}"
        raise InputError(where, "controller.thrusters.azimuth_turning", "true", allowed)
    return ThrusterControl(thrusters, rows, np.diag(W), turning)


def allocation_of(
    spec: ScenarioFile,
    control: ThrusterControl | None,
    vessel: Vessel,
    sample_s: float,
    where: str,
) -> Allocation | None:
    """How the force of a cascade is allocated; None where the controller is none."""
    table = spec.controller.thrusters
    if spec.controller.kind != "cascade" or control is None or table is None:
        return None
    assert table.slack_weight_relative is not None, "the table demands it"
    df_max, step_max = control.thrusters.step_max(sample_s), vessel.step_max(sample_s)
    R = np.diag(table.move_weight_relative / df_max**2)
    slack = np.diag(table.slack_weight_relative / step_max**2)
    problem = AllocationProblem(
        control.thrusters.T_e, control.rows, control.W, R, slack, df_max, step_max
    )
    faults = tuple(
        (k, *control.rows.without(lost), frozenset(lost))
        for k, lost in _losses(spec, vessel, where)
    )
    return Allocation(control, problem, table.allocation != "pseudo_inverse", faults)


def attainable_of(controller: ControllerTable, vessel: Vessel, where: str) -> AttainableSet | None:
    """What limits the force as a whole; InputError where the vessel has no thrusters."""
    if controller.limits == "box":
        return None
    if vessel.thrusters is None:
        allowed = f'"box", or thrusters in the file of vessel {vessel.id}'
        raise InputError(where, "controller.limits", '"attainable"', allowed)
    return attainable_set(vessel.thrusters, controller.attainable_sides)


def faults_of(
    spec: ScenarioFile,
    vessel: Vessel,
    of_thrusters: ThrusterControl | AttainableSet | None,
    where: str,
) -> tuple[tuple[int, Vector, Vector], ...]:
    """(sample, least, most) of the limits of u after each fault that changes them."""
    commanded = of_thrusters is not None or spec.controller.kind == "cascade"
    for i, fault in enumerate(_in_time(spec)):
        if not (commanded if fault.lost is not None else of_thrusters is None):
            found = "lost" if fault.lost is not None else "limit_share"
            allowed = (
                "lost where thrusters limit the force or are commanded, limit_share where each "
                "axis of the force has a limit of its own"
            )
            raise InputError(where, f"faults.{i}", found, allowed)
    if of_thrusters is not None:
        losses = _losses(spec, vessel, where)
        return tuple((k, *_without(of_thrusters, lost)) for k, lost in losses)
    shares = (
        (round(fault.at_s / spec.sample_s), np.array(fault.limit_share))
        for fault in _in_time(spec)
        if fault.limit_share is not None
    )
    return tuple((k, share * vessel.tau_min, share * vessel.tau_max) for k, share in shares)


def _in_time(spec: ScenarioFile) -> list[FaultTable]:
    return sorted(spec.faults, key=lambda fault: fault.at_s)


def _losses(spec: ScenarioFile, vessel: Vessel, where: str) -> list[tuple[int, set[int]]]:
    """(sample, numbers of lost thrusters) of each fault; what was lost before stays lost."""
    losses: list[tuple[int, set[int]]] = []
    gone: set[int] = set()
    for i, fault in enumerate(_in_time(spec)):
        if fault.lost is not None:
            assert vessel.thrusters is not None, "known by now"
            gone = gone | vessel.thrusters.numbers(fault.lost, where, f"faults.{i}.lost")
            losses.append((round(fault.at_s / spec.sample_s), gone))
    return losses


def _without(
    of_thrusters: ThrusterControl | AttainableSet, gone: set[int]
) -> tuple[Vector, Vector]:
    if isinstance(of_thrusters, AttainableSet):
        return of_thrusters.limits(gone)
    return of_thrusters.rows.without(gone)


def actuators_of(
    spec: ScenarioFile, control: ThrusterControl | None, sample_s: float, scale: Froude
) -> Actuators | CommandedThrusters | None:
    """What stands between commands and the hull; None for nothing."""
    plant = spec.plant
    loss = np.array(plant.thrust_loss_percent)
    behind = Actuators(1.0 - loss / 100.0, plant.delay_samples)
    if control is not None:
        lag_s = plant.thruster_lag_s * scale.time
        return CommandedThrusters(control.thrusters, sample_s, lag_s, behind)
    if not loss.any() and plant.delay_samples == 0:
        return None
    return behind
