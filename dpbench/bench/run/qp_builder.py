"""The QPs of a run: what the builder emits at step k for the state, the reference and the limits of
that step.

The loop emits along the way; evaluators and sequences emit the same QPs again from the recorded θ.
"""

from __future__ import annotations

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.condense import UnitSystem
from dpbench.qp.program import QPStep
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
    n_f : entries of the thrusters' forces, where they are steered; 0 else.
    """

    def __init__(
        self, scenario: Scenario, units: UnitSystem = "scaled", *, sparse: bool = False
    ) -> None:
        self.condensed = condense(scenario, units=units)
        self.staged = keep_states(scenario, units=units) if sparse else None
        self._emit = self.condensed.emit if self.staged is None else self.staged.emit
        self.reference: Matrix = scenario.reference_table(scenario.steps + scenario.N_p)
        self.n_f = 0 if scenario.steered is None else scenario.steered.thrusters.n_f
        self.u_min, self.u_max = scenario.limit_tables(scenario.steps)
        self._horizon = scenario.N_p if scenario.preview else 0
        # The vessel's own limits are in the builder; limits of a fault are handed over.
        self._fault = min((k for k, _, _ in scenario.faults), default=scenario.steps)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """n and m of the condensed QPs, the length of [θ; 1], and n_f."""
        return self.condensed.n, self.condensed.m, int(self.condensed.Z.shape[1]), self.n_f

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
