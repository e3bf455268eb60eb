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
    def of(cls, spec: ControllerSpec) -> ForceController:
        """Build the force controller of a scenario, with limits axis by axis or joint ones."""
        spec.check_faults(lost=spec.table.limits != "box", limit_share=spec.table.limits == "box")
        spec.refuse_trips()
        problem, changes = build_force_plan(spec)
        wanted = ForceController if problem.thrusters is None else JointForceController
        return wanted(problem=problem, changes=changes, **spec.planning)

    def force(self, u: Matrix) -> Matrix:
        """Return the commands unchanged: they are forces on the ship (..., 3)."""
        return u

    def select_applied(self, tau: Matrix, thrust: Matrix) -> Matrix:
        """Return the forces tau (K, 3), which are the commands."""
        return tau


class JointForceController(ForceController):
    """Controller that commands a force within what the thrusters attain together."""

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("joint_limits",)


def build_force_plan(spec: ControllerSpec) -> tuple[ControlProblem, Changes]:
    """Return the MPC problem of a planned force, and the changes of its limits by faults."""
    ship = spec.vessel
    R, du_max = np.diag(_move_weights(spec)), ship.largest_force_change_per_sample(spec.sample_s)
    if spec.table.limits == "box":
        rows, limits = None, Limits(ship.tau_min, ship.tau_max)
        changes = tuple(
            (k, Limits(share * ship.tau_min, share * ship.tau_max))
            for k, share in spec.limit_shares
        )
    else:
        thrusters = spec.require_thrusters("limits", "attainable", "box")
        attainable = build_attainable_force_polytope(thrusters, spec.table.attainable_sides)
        rows = attainable.to_linear_limit_rows()
        limits = rows.intact
        changes = tuple((k, attainable.facet_limits_after_loss(lost)) for k, lost in spec.losses)
    return spec.build_problem(limits, du_max, R, rows=rows), changes


def _move_weights(spec: ControllerSpec) -> Vector:
    """Return the weights R (3,) of the control increments, in SI units."""
    table = spec.table
    if table.move_weight_relative is not None:
        return (
            np.array(table.move_weight_relative)
            / spec.vessel.largest_force_change_per_sample(spec.sample_s) ** 2
        )
    assert table.move_weight is not None, "the table demands one of the two"
    return np.array(table.move_weight) / spec.scale.force_and_moment_factors**2
