"""The QPs of a run: what the builder emits at step k for the state, the reference and the limits of
that step.

The loop emits along the way; evaluators and sequences emit the same QPs again from the recorded θ.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import Formulation
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.qp.stacked import stack, stack_step, unstack
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


NO_MODEL = "the QPs of a scenario; recorded and random ones bring no model whose states to keep"


class Formulated(Protocol):
    """One formulation of a sequence of QPs.

    Attributes
    ----------
    base : the problem a workspace is set up with, in this formulation.
    """

    base: QuadraticProgram

    def step(self, step: QPStep) -> QPStep:
        """What the solver gets of an emitted step; a part of emitting it.

        New matrices become those of `base`, so that a later step without any is solved with the
        same ones. Of the arrays that go to the solver nobody else keeps any.
        """

    def solution(self, answer: Solution) -> Solution:
        """The answer to the condensed problem."""


class Box:
    """The condensed problem as it is emitted: nothing to do."""

    def __init__(self, base: QuadraticProgram) -> None:
        self.base = base

    def step(self, step: QPStep) -> QPStep:
        """The step itself."""
        # Asking the flag `refresh` takes half a microsecond, and this is a part of emitting.
        if not (step.P is None and step.A is None and step.lb is None and step.ub is None):
            self.base = self.base.at(step)
            return step.copy()
        return step

    def solution(self, answer: Solution) -> Solution:
        """The answer itself."""
        return answer


class Stacked(Box):
    """The paper's one-sided rows (eq. 23-25), made of each emitted step."""

    def __init__(self, base: QuadraticProgram) -> None:
        super().__init__(stack(base))
        self._m = base.m

    def step(self, step: QPStep) -> QPStep:
        """The step with all limits as one-sided rows."""
        return super().step(stack_step(step, self.base))

    def solution(self, answer: Solution) -> Solution:
        """The multipliers of both sides of a row joined."""
        return unstack(answer, self._m)


class Sparse(Box):
    """The stage-ordered problem: its steps are emitted as such, its answers are condensed.

    Parameters
    ----------
    base : a problem of the sequence; condensed : maps an answer (`StagedQP.condensed`).
    """

    def __init__(self, base: QuadraticProgram, condensed: Callable[[Solution], Solution]) -> None:
        super().__init__(base)
        self._condensed = condensed

    def solution(self, answer: Solution) -> Solution:
        """The moves and the multipliers of their limits."""
        return self._condensed(answer)


def in_loop(formulation: Formulation, builder: QPBuilder, base: QuadraticProgram) -> Formulated:
    """The formulation of a closed loop; `base` is a condensed problem of the builder.

    The steps of "sparse" are those of a builder that was told so.
    """
    if builder.staged is None:
        return _of_condensed(formulation, base)
    model = builder.staged.control.model
    at_rest = np.zeros(model.n_x), np.zeros(model.n_y), np.zeros(model.n_u)
    staged = builder.staged
    return Sparse(staged.problem(staged.emit(*at_rest)), staged.condensed)


def in_replay(formulation: Formulation, sequence: QPSequence) -> tuple[QPSequence, Formulated]:
    """The steps to replay and their formulation; those of "sparse" are all made here, once.

    Raises
    ------
    InputError : for "sparse", where nobody knows the model behind the QPs.
    """
    if formulation != "sparse":
        return sequence, _of_condensed(formulation, sequence.base)
    if sequence.sparse_equivalent is None:
        raise InputError(f"sequence {sequence.name}", "formulation", "'sparse'", NO_MODEL)
    sparse = sequence.sparse_equivalent()
    return sparse.sequence, Sparse(sparse.sequence.base, sparse.condensed)


def _of_condensed(formulation: Formulation, base: QuadraticProgram) -> Formulated:
    return Stacked(base) if formulation == "condensed_stacked" else Box(base)
