"""The controllers that command a force in surge, sway and yaw, as the paper's."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.thruster_rows import Limits
from dpbench.mpc.thrusters.attainable_set import build_attainable_force_polytope
from dpbench.scenario.controllers.controller import Changes, Controller, MetricGroup
from dpbench.scenario.controllers.specification import ControllerSpec


class ForceController(Controller):
    """Controller that commands a force in surge, sway and yaw, with limits axis by axis."""

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("axis_limits",)

    @classmethod
    def from_specification(cls, spec: ControllerSpec) -> ForceController:
        """Build the force controller of a scenario, with limits axis by axis or joint ones."""
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
