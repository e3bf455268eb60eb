"""The cascade: a plan of forces, which a second QP or the pseudo-inverse allocates to thrusters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.thruster_rows import Limits
from dpbench.mpc.thrusters.allocation_qp import AllocationProblem, AllocationQP
from dpbench.scenario.controllers.commanded import ThrusterControl, thruster_control
from dpbench.scenario.controllers.controller import Changes, MetricGroup, limits_at_samples
from dpbench.scenario.controllers.forces import ForceController, force_plan
from dpbench.scenario.controllers.specification import ControllerSpec


@dataclass(frozen=True, eq=False)
class CascadeController(ForceController):
    """u is the force τ (3,), which is then allocated at each sample.

    control : thrusters, their rows and weight; allocation : what is weighed and may be done.
    by_qp : whether a QP allocates, or the pseudo-inverse.
    losses : changes of the limits of the thrusters, by faults.
    """

    control: ThrusterControl
    allocation: AllocationProblem
    by_qp: bool
    losses: Changes

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ("thrusters", "delivery")
    allocates: ClassVar[bool] = True
    commands: ClassVar[str] = ", cascade"
    why_no_delay: ClassVar[str] = "slowdown: not of a cascade, whose QPs are two"

    @classmethod
    def of(cls, spec: ControllerSpec) -> CascadeController:
        """Return the controller of a scenario file; InputError for a vessel that does not fit."""
        control, table = thruster_control(spec), spec.thruster_table
        spec.check_faults(lost=True, limit_share=spec.table.limits == "box")
        problem, changes = force_plan(spec)
        thrusters, rows = control.thrusters, control.rows
        df_max, step_max = thrusters.step_max(spec.sample_s), problem.du_max
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
            losses=tuple((k, rows.without(lost)) for k, lost in spec.losses),
            **spec.planning,
        )

    @property
    def commanded(self) -> ThrusterControl:
        """The thrusters that the force is allocated to."""
        return self.control

    @property
    def built_in_limits(self) -> None:
        """None: what thrusters make of a demand may lie beyond the limits of the force, from where
        limits that are handed over are reachable."""
        return None

    def build_allocation(self, units: UnitSystem = "scaled") -> AllocationQP | None:
        """Return the builder of the second QPs; None where the pseudo-inverse allocates."""
        return AllocationQP(self.allocation, units=units) if self.by_qp else None

    def thruster_limits(self, samples: int) -> list[Limits]:
        """Return the limits of the thrusters in force at each sample."""
        return limits_at_samples(self.control.rows.intact, self.losses, samples)

    def as_baseline_law(self) -> CascadeController:
        """Return the cascade without its second QP: a law that ignores all constraints ignores
        the demand too."""
        return replace(self, by_qp=False)
