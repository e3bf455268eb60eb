"""The controller that plans the forces of thrusters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dpbench.arrays import Matrix
from dpbench.mpc.move_limits import MoveLimit
from dpbench.mpc.thruster_rows import Limits
from dpbench.scenario.controllers.commanded import (
    ThrusterControl,
    TurningThrusterControl,
    thruster_control,
)
from dpbench.scenario.controllers.controller import Controller, MetricGroup
from dpbench.scenario.controllers.linearisation import turning_rows
from dpbench.scenario.controllers.specification import ControllerSpec


@dataclass(frozen=True, eq=False)
class ThrusterController(Controller):
    """u are the forces f (n_f,) of the ship's thrusters."""

    control: ThrusterControl

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("thrusters",)
    commands: ClassVar[str] = ", thrusters"

    @classmethod
    def of(cls, spec: ControllerSpec) -> ThrusterController:
        """Return the controller of a scenario file; InputError for a vessel that does not fit."""
        control, planning = thruster_control(spec), spec.planning
        spec.check_faults(lost=True, limit_share=False)
        if isinstance(control, TurningThrusterControl):
            planning["linearisation"] = turning_rows(control.turning)
        thrusters, rows = control.thrusters, control.rows
        df_max = thrusters.step_max(spec.sample_s)
        R = np.diag(spec.thruster_table.move_weight_relative / df_max**2)
        T_e = thrusters.T_e
        problem = spec.problem(rows.intact, df_max, R, rows=rows, T_e=T_e, W=control.W)
        changes = tuple((k, rows.without(lost)) for k, lost in spec.losses)
        return cls(problem=problem, changes=changes, control=control, **planning)

    @property
    def commanded(self) -> ThrusterControl:
        """The thrusters, whose forces are planned."""
        return self.control

    def move_limit(self) -> MoveLimit:
        """Return what limits the moves of a run, turning of azimuths included."""
        return self.control.move_limit(self.problem.du_max)

    def thruster_limits(self, samples: int) -> list[Limits]:
        """Return the limits of u."""
        return self.limits(samples)

    def force(self, u: Matrix) -> Matrix:
        """Return T_e u."""
        force: Matrix = u @ self.control.thrusters.T_e.T
        return force

    def applied(self, tau: Matrix, thrust: Matrix) -> Matrix:
        """Return the forces of the thrusters."""
        return thrust
