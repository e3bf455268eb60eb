"""The interface of controllers, which plan by a condensed QP of their `problem`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dpbench.arrays import Matrix
from dpbench.errors import InputError
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.condensed_qp import Amplitude, CondensedQP
from dpbench.mpc.move_limits import MoveLimit, make_increment_limiter
from dpbench.mpc.soft_limits import OutputBounds
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import Limits
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.scenario.controllers.commanded import ThrusterControl
from dpbench.scenario.controllers.specification import Linearisation

Changes = tuple[tuple[int, Limits], ...]
"""(sample, limits) from which on these limits hold, in order of time."""
MetricGroup = Literal["axis_limits", "joint_limits", "thrusters", "delivery"]
"""Metrics that not every controller has: limits of each axis of the force, of the force as a whole,
of thrusters and their wear, and force demanded but not delivered."""


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

    def adapt_to_baseline_law(self) -> Controller:
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
