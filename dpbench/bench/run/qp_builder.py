"""The QPs of a run: what the builder emits at step k for the state, the reference and the limits of
that step.

The loop emits along the way; evaluators and sequences emit the same QPs again from the recorded θ.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.qp.program import QPStep
from dpbench.scenario.scenario import Scenario


class QPBuilder:
    """Emits the QPs of a scenario.

    Parameters
    ----------
    scenario : the run; units : of the QPs; sparse : whether they keep the states.

    Attributes
    ----------
    condensed : the builder of the condensed QPs; staged : that of the sparse ones, if they are
        meant.
    reference (K + N_p, 3) : what is wanted at each sample; limits (K) : what is allowed of u.
    allocation : the builder of second QPs, which allocate the force; None where there are none.
    thruster_limits (K) : what is allowed of thrusters that are commanded.
    """

    def __init__(
        self, scenario: Scenario, units: UnitSystem = "scaled", *, sparse: bool = False
    ) -> None:
        controller, steps = scenario.controller, scenario.steps
        self.condensed: CondensedQP = controller.build_qp(units)
        self.staged: StagedQP | None = None
        if sparse:
            self.staged = controller.build_sparse_qp(units, f"scenario {scenario.name}")
        self._emit = self.condensed.emit if self.staged is None else self.staged.emit
        N_p = controller.problem.N_p
        self.reference: Matrix = scenario.reference_table(steps + N_p)
        self._horizon = N_p if scenario.preview else 0
        self.allocation: AllocationQP | None = controller.build_allocation(units)
        self.limits = controller.limits(steps)
        self.thruster_limits = controller.thruster_limits(steps)
        self._n_f = controller.n_f
        # Limits that a builder has built in are not handed over to it again.
        self._built_in, self._allocates = controller.built_in_limits, controller.allocates

    @property
    def sizes(self) -> tuple[int, int, int, int, tuple[int, int] | None]:
        """n and m of the condensed QPs, the length of [θ; 1], n_f, and of a cascade n and m of its
        second QP, zero where it has none."""
        second = (0, 0) if self._allocates else None
        if self.allocation is not None:
            second = self.allocation.n, self.allocation.m
        condensed = self.condensed
        return condensed.n, condensed.m, int(condensed.Z.shape[1]), self._n_f, second

    def emit(self, k: int, x: Vector, u_prev: Vector) -> QPStep:
        """The QP of step k: x (9,), u_prev (n_u,) as for `CondensedQP.emit`."""
        table, ahead = self.reference, self._horizon
        y_ref = table[k + 1 : k + 1 + ahead] if ahead else table[k]
        limits = self.limits[k]
        if limits is self._built_in:
            return self._emit(x, y_ref, u_prev)
        return self._emit(x, y_ref, u_prev, limits=limits)

    def rebuild(self, k: int, theta: Vector) -> QPStep:
        """The QP of step k from its recorded [x; y_ref; u_prev; 1]."""
        model = self.condensed.control.model
        n_x, n_y = model.n_x, model.n_y
        return self.emit(k, theta[:n_x], theta[n_x + n_y : -1])

    def allocate(self, k: int, demand: Vector, f_prev: Vector) -> QPStep:
        """The second QP of step k of a cascade: demand (3,), f_prev (n_f,) as for
        `AllocationQP.emit`."""
        assert self.allocation is not None, "a QP allocates"
        limits = self.thruster_limits[k]
        if limits is self.allocation.allocation.rows.intact:
            return self.allocation.emit(demand, f_prev)
        return self.allocation.emit(demand, f_prev, limits=limits)

    def allocate_again(self, k: int, demand: Matrix, thrust: Matrix) -> QPStep:
        """The second QP of step k from the recorded demand (K, 3) and forces (K, n_f)."""
        return self.allocate(k, demand[k], thrust[k - 1] if k else np.zeros(self._n_f))
