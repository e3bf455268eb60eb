"""The kinds of controllers: of a force as the paper's, of forces of thrusters, and a cascade.

A cascade plans the force, which a second QP or the pseudo-inverse allocates to the thrusters.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.move_limits import MoveLimit
from dpbench.mpc.thruster_rows import Limits
from dpbench.mpc.thrusters.allocation_qp import AllocationProblem, AllocationQP
from dpbench.mpc.thrusters.attainable_set import build_attainable_force_polytope
from dpbench.scenario.controllers.controller import (
    Changes,
    Controller,
    ControllerSpec,
    MetricGroup,
    ThrusterControl,
    TurningThrusterControl,
    build_commanded_thrusters,
    list_force_limits_by_sample,
    make_factory_of_turning_limited_qps,
)


class ForceController(Controller):
    """Controller that commands a force in surge, sway and yaw, with limits axis by axis."""

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("axis_limits",)

    @classmethod
    def from_specification(cls, spec: ControllerSpec) -> "ForceController":
        """Return the force controller of a scenario, with limits axis by axis or joint ones."""
        spec.refuse_unsupported_faults(
            lost=spec.controller_table.limits != "box",
            limit_share=spec.controller_table.limits == "box",
        )
        spec.refuse_instant_thruster_stops()
        problem, changes = build_force_problem_and_limits(spec)
        wanted = ForceController if problem.thrusters is None else JointForceController
        return wanted(problem=problem, changes=changes, **spec.planning_settings)

    def convert_commands_to_ship_force(self, u: Matrix) -> Matrix:
        """Return the commands unchanged: they are forces on the ship (..., 3)."""
        return u

    def select_applied_commands(self, tau: Matrix, thrust: Matrix) -> Matrix:
        """Return the forces tau (K, 3), which are the commands."""
        return tau


class JointForceController(ForceController):
    """Controller that commands a force within what the thrusters attain together."""

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("joint_limits",)


def build_force_problem_and_limits(spec: ControllerSpec) -> tuple[ControlProblem, Changes]:
    """Return the MPC problem of a planned force, and the changes of its limits by faults."""
    ship = spec.vessel
    R, du_max = (
        np.diag(_compute_increment_weights(spec)),
        ship.largest_force_change_per_sample(spec.sample_s),
    )
    if spec.controller_table.limits == "box":
        rows, limits = None, Limits(ship.tau_min, ship.tau_max)
        changes = tuple(
            (k, Limits(share * ship.tau_min, share * ship.tau_max))
            for k, share in spec.samples_and_shares_of_limit_faults
        )
    else:
        thrusters = spec.require_thrusters_for_key("limits", "attainable", "box")
        attainable = build_attainable_force_polytope(
            thrusters, spec.controller_table.attainable_sides
        )
        rows = attainable.to_linear_limit_rows()
        limits = rows.intact
        changes = tuple(
            (k, attainable.facet_limits_after_loss(lost))
            for k, lost in spec.samples_and_lost_thrusters_of_faults
        )
    return spec.build_control_problem(limits, du_max, R, rows=rows), changes


def _compute_increment_weights(spec: ControllerSpec) -> Vector:
    """Return the weights R (3,) of the control increments, in SI units."""
    table = spec.controller_table
    if table.move_weight_relative is not None:
        return (
            np.array(table.move_weight_relative)
            / spec.vessel.largest_force_change_per_sample(spec.sample_s) ** 2
        )
    assert table.move_weight is not None, "the table demands one of the two"
    return np.array(table.move_weight) / spec.scale.force_and_moment_factors**2


@dataclass(frozen=True, eq=False)
class ThrusterController(Controller):
    """Controller that commands the forces (n_f,) of the ship's thrusters directly."""

    control: ThrusterControl

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("thrusters",)
    commands: ClassVar[str] = ", thrusters"

    @classmethod
    def from_specification(cls, spec: ControllerSpec) -> "ThrusterController":
        """Return the thruster controller of a scenario; InputError without fitting thrusters."""
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
    why_no_delay: ClassVar[str] = "a cascade, as it solves two QPs per sample"

    @classmethod
    def from_specification(cls, spec: ControllerSpec) -> "CascadeController":
        """Return a force controller with thrust allocation; InputError without thrusters."""
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

    def adapt_to_baseline_law(self) -> "CascadeController":
        """Return this controller with allocation by pseudo-inverse in place of a QP."""
        return replace(self, by_qp=False)
