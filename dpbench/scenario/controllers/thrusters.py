"""Controllers that command thrusters: by a plan of their forces, or by a cascade.

A cascade plans the force, which a second QP or the pseudo-inverse allocates to the thrusters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dpbench.arrays import Matrix
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.move_limits import MoveLimit
from dpbench.mpc.thruster_rows import Limits
from dpbench.mpc.thrusters.allocation_qp import AllocationProblem, AllocationQP
from dpbench.scenario.controllers.commanded import (
    ThrusterControl,
    TurningThrusterControl,
    build_commanded_thrusters,
)
from dpbench.scenario.controllers.controller import (
    Changes,
    Controller,
    MetricGroup,
    list_force_limits_by_sample,
)
from dpbench.scenario.controllers.forces import ForceController, build_force_problem_and_limits
from dpbench.scenario.controllers.specification import (
    ControllerSpec,
    make_factory_of_turning_limited_qps,
)


@dataclass(frozen=True, eq=False)
class ThrusterController(Controller):
    """Controller that commands the forces (n_f,) of the ship's thrusters directly."""

    control: ThrusterControl

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("thrusters",)
    commands: ClassVar[str] = ", thrusters"

    @classmethod
    def from_specification(cls, spec: ControllerSpec) -> ThrusterController:
        """Build the thruster controller of a scenario; InputError without fitting thrusters."""
        control, planning = build_commanded_thrusters(spec), spec.planning_settings
        spec.refuse_unsupported_faults(lost=True, limit_share=False)
        if isinstance(control, TurningThrusterControl):
            planning["linearisation"] = make_factory_of_turning_limited_qps(control.turning)
        thrusters, rows = control.thrusters, control.rows
        df_max = thrusters.largest_force_changes_per_sample(spec.sample_s)
        R = np.diag(spec.thruster_table.move_weight_relative / df_max**2)
        T_e = thrusters.T_e
        problem = spec.build_control_problem(
            rows.intact, df_max, R, rows=rows, T_e=T_e, W=control.W
        )
        changes = tuple(
            (k, rows.limits_after_loss_of_thrusters(lost))
            for k, lost in spec.samples_and_lost_thrusters_of_faults
        )
        return cls(problem=problem, changes=changes, control=control, **planning)

    @property
    def commanded_thrusters(self) -> ThrusterControl:
        """Commanded thrusters, whose forces the MPC plans."""
        return self.control

    def make_increment_limiter(self) -> MoveLimit:
        """Return the limiter of thruster force changes, for thrust and turning rates."""
        return self.control.make_increment_limiter(self.problem.du_max)

    def list_thruster_limits_by_sample(self, samples: int) -> list[Limits]:
        """Return the limits of the thrusters at each sample, faults included."""
        return self.list_planned_force_limits_by_sample(samples)

    def convert_commands_to_ship_force(self, u: Matrix) -> Matrix:
        """Return the force on the ship (..., 3) of thruster forces u (..., n_f)."""
        force: Matrix = u @ self.control.thrusters.T_e.T
        return force

    def select_applied_commands(self, tau: Matrix, thrust: Matrix) -> Matrix:
        """Return the thruster forces (K, n_f), which are the commands."""
        return thrust


@dataclass(frozen=True, eq=False)
class CascadeController(ForceController):
    """Controller that plans a force (3,), then allocates it; losses : limits after faults."""

    control: ThrusterControl
    allocation: AllocationProblem
    by_qp: bool
    losses: Changes

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("thrusters", "delivery")
    allocates: ClassVar[bool] = True
    commands: ClassVar[str] = ", cascade"
    why_no_delay: ClassVar[str] = "slowdown: not of a cascade, whose QPs are two"

    @classmethod
    def from_specification(cls, spec: ControllerSpec) -> CascadeController:
        """Build a force controller with thrust allocation; InputError without thrusters."""
        control, table = build_commanded_thrusters(spec), spec.thruster_table
        spec.refuse_unsupported_faults(lost=True, limit_share=spec.controller_table.limits == "box")
        problem, changes = build_force_problem_and_limits(spec)
        thrusters, rows = control.thrusters, control.rows
        df_max, step_max = thrusters.largest_force_changes_per_sample(spec.sample_s), problem.du_max
        assert table.slack_weight_relative is not None, "the table demands it"
        R = np.diag(table.move_weight_relative / df_max**2)
        slack = np.diag(table.slack_weight_relative / step_max**2)
        return cls(
            problem=problem,
            changes=changes,
            control=control,
            allocation=AllocationProblem(
                thrusters.T_e, rows, control.W, R, slack, df_max, step_max
            ),
            by_qp=table.allocation != "pseudo_inverse",
            losses=tuple(
                (k, rows.limits_after_loss_of_thrusters(lost))
                for k, lost in spec.samples_and_lost_thrusters_of_faults
            ),
            **spec.planning_settings,
        )

    @property
    def commanded_thrusters(self) -> ThrusterControl:
        """Commanded thrusters, to which the planned force is allocated."""
        return self.control

    @property
    def limits_built_into_qp(self) -> None:
        """None: limits enter each step's QP, as thrusters may miss the planned force."""
        return None

    def make_allocation_qp_builder(self, units: UnitSystem = "scaled") -> AllocationQP | None:
        """Return the builder of the allocation QPs; None where the pseudo-inverse allocates."""
        return AllocationQP(self.allocation, units=units) if self.by_qp else None

    def list_thruster_limits_by_sample(self, samples: int) -> list[Limits]:
        """Return the thrusters' force limits at each sample, lost thrusters included."""
        return list_force_limits_by_sample(self.control.rows.intact, self.losses, samples)

    def adapt_to_baseline_law(self) -> CascadeController:
        """Return this controller with allocation by pseudo-inverse in place of a QP."""
        return replace(self, by_qp=False)
