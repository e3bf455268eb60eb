"""The QPs of a run: what the builder emits at step k for the state, the reference and the limits of
that step.

The loop emits along the way; evaluators and sequences emit the same QPs again from the recorded θ.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.qp.program import QPStep
from dpbench.scenario.commanded_thrusters import Allocation
from dpbench.scenario.scenario import Scenario, condense, keep_states


class QPBuilder:
    """Emits the QPs of a scenario.

    Parameters
    ----------
    scenario : the run; units : of the QPs; sparse : whether they keep the states.

    Attributes
    ----------
    condensed : the builder of the condensed QPs; staged : that of the sparse ones, if they are
        meant.
    reference (K + N_p, 3), u_min, u_max (K, r) : what is wanted and allowed at each sample.
    n_f : entries of the thrusters' forces, where they are commanded; 0 else.
    allocation : of a cascade, the builder of its second QP; None where there is none.
    f_min, f_max (K, r) : of a cascade, what is allowed of its thrusters at each sample.
    """

    def __init__(
        self, scenario: Scenario, units: UnitSystem = "scaled", *, sparse: bool = False
    ) -> None:
        self.condensed = condense(scenario, units=units)
        self.staged = keep_states(scenario, units=units) if sparse else None
        self._emit = self.condensed.emit if self.staged is None else self.staged.emit
        self.reference: Matrix = scenario.reference_table(scenario.steps + scenario.N_p)
        commanded = scenario.commanded
        self.n_f = 0 if commanded is None else commanded.thrusters.n_f
        self.u_min, self.u_max = scenario.limit_tables(scenario.steps)
        self._horizon = scenario.N_p if scenario.preview else 0
        # The vessel's own limits are in the builder; limits of a fault are handed over.
        self._fault = min((k for k, _, _ in scenario.faults), default=scenario.steps)
        self.allocation: AllocationQP | None = None
        self._cascade = scenario.allocation
        if scenario.allocation is not None:
            # What thrusters make of a demand may lie beyond the limits of the force, from where
            # limits that are handed over are reachable.
            self._fault = 0
            self._prepare_allocation(scenario.allocation, scenario.steps, units)

    def _prepare_allocation(self, cascade: Allocation, steps: int, units: UnitSystem) -> None:
        if cascade.by_qp:
            self.allocation = AllocationQP(cascade.problem, units=units)
        self.f_min, self.f_max = cascade.limit_tables(steps)
        self._loss = min((k for k, _, _, _ in cascade.faults), default=steps)

    @property
    def sizes(self) -> tuple[int, int, int, int, tuple[int, int] | None]:
        """n and m of the condensed QPs, the length of [θ; 1], n_f, and of a cascade n and m of its
        second QP, zero where it has none."""
        second = None if self._cascade is None else (0, 0)
        if self.allocation is not None:
            second = self.allocation.n, self.allocation.m
        condensed = self.condensed
        return condensed.n, condensed.m, int(condensed.Z.shape[1]), self.n_f, second

    def emit(self, k: int, x: Vector, u_prev: Vector) -> QPStep:
        """The QP of step k: x (9,), u_prev (n_u,) as for `CondensedQP.emit`."""
        table, ahead = self.reference, self._horizon
        y_ref = table[k + 1 : k + 1 + ahead] if ahead else table[k]
        if k < self._fault:
            return self._emit(x, y_ref, u_prev)
        limits = self.u_min[k], self.u_max[k]
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
        if k < self._loss:
            return self.allocation.emit(demand, f_prev)
        return self.allocation.emit(demand, f_prev, limits=(self.f_min[k], self.f_max[k]))

    def allocate_again(self, k: int, demand: Matrix, thrust: Matrix) -> QPStep:
        """The second QP of step k from the recorded demand (K, 3) and forces (K, n_f)."""
        return self.allocate(k, demand[k], thrust[k - 1] if k else np.zeros(self.n_f))
