"""The QPs of a run, and formulations of them for a solver.

The loop emits QPs along the way; evaluators and sequences emit them again from the recorded θ.
Whatever the solver is given, logs, fallback and referee use the condensed problem.

The paper's stacked form (eq. 23-25) has one-sided rows:

    M z ≤ γ   with   M = [−A; A; −I; I],   γ = [−l; u; −lb; ub]
    rows                 0    m  2m  2m+n  2m+2n

For N_p 30, N_c 5 these are the paper's 60 rows: M1 = [−C2; C2], M2 = [−I; I]. The multipliers of
the two sides of one row combine to y = λ_upper − λ_lower.
"""

from collections.abc import Callable

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import Formulation
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thrusters.allocation_qp import AllocationQP
from dpbench.qp.program import CONSTANT, QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.scenario.plants.linear_mpc import LinearMPC
from dpbench.scenario.scenario import Scenario
from dpbench.ship.layout import AXES, STATE

Case = Scenario | LinearMPC
"""Task of a closed loop: a ship's scenario, or a linear MPC with a custom plant."""


class QPBuilder:
    """Builder of the QPs of a scenario's controller, and of a cascade's allocation, by step.

    Attributes
    ----------
    condensed, staged : builders of condensed and of sparse QPs; allocation : of a cascade's second.
    reference (K + N_p, n_y) : wanted pose; limits, thruster_limits (K) : of u and of thrusters.
    states, inputs : numbers of states and inputs of the plant.
    """

    def __init__(
        self, scenario: Case, units: UnitSystem = "scaled", *, sparse: bool = False
    ) -> None:
        controller, steps = scenario.controller, scenario.steps
        self.condensed: CondensedQP = controller.make_condensed_qp_builder(units)
        self.staged: StagedQP | None = None
        if sparse:
            self.staged = controller.make_sparse_qp_builder(units, f"scenario {scenario.name}")
        self._emit = self.condensed.emit if self.staged is None else self.staged.emit
        N_p = controller.problem.N_p
        self.states, self.inputs = STATE, AXES
        if isinstance(scenario, LinearMPC):
            self.states, self.inputs = scenario.model.n_x, scenario.model.n_u
        self.reference: Matrix = scenario.build_reference_table(steps + N_p)
        self._horizon = N_p if scenario.preview else 0
        self.allocation: AllocationQP | None = controller.make_allocation_qp_builder(units)
        self.limits = controller.list_planned_force_limits_by_sample(steps)
        self.thruster_limits = controller.list_thruster_limits_by_sample(steps)
        self._n_f, self._commanded = controller.thruster_force_count, controller.commanded_thrusters
        # Limits that a builder has built in are not handed over to it again.
        self._built_in, self._allocates = controller.limits_built_into_qp, controller.allocates

    @property
    def sizes(self) -> tuple[int, int, int, int, tuple[int, int] | None]:
        """QP size n, m; length of [θ; 1]; thruster forces n_f; size of the thrust-allocation QP."""
        second = (0, 0) if self._allocates else None
        if self.allocation is not None:
            second = self.allocation.n, self.allocation.m
        condensed = self.condensed
        return condensed.n, condensed.m, int(condensed.Z.shape[1]), self._n_f, second

    def emit(self, k: int, x: Vector, u_prev: Vector) -> QPStep:
        """Return the MPC QP of step k for state x (9,) and previous input u_prev (n_u,)."""
        table, ahead = self.reference, self._horizon
        y_ref = table[k + 1 : k + 1 + ahead] if ahead else table[k]
        limits = self.limits[k]
        if limits is self._built_in:
            return self._emit(x, y_ref, u_prev)
        return self._emit(x, y_ref, u_prev, limits=limits)

    def rebuild(self, k: int, theta: Vector) -> QPStep:
        """Return the MPC QP of step k from its recorded parameters θ = [x; y_ref; u_prev; 1]."""
        model = self.condensed.control.model
        n_x, n_y = model.n_x, model.n_y
        return self.emit(k, theta[:n_x], theta[n_x + n_y : -1])

    def emit_allocation(self, k: int, demand: Vector, f_prev: Vector) -> QPStep:
        """Return the thrust-allocation QP of step k for a demanded force (3,) and f_prev (n_f,)."""
        assert self.allocation is not None, "a QP allocates"
        limits = self.thruster_limits[k]
        if limits is self.allocation.allocation.rows.intact:
            return self.allocation.emit(demand, f_prev)
        return self.allocation.emit(demand, f_prev, limits=limits)

    def rebuild_allocation(self, k: int, demand: Matrix, thrust: Matrix) -> QPStep:
        """Return the thrust-allocation QP of step k from recorded demand (K, 3) and thrust."""
        assert self._commanded is not None, "a cascade"
        return self.emit_allocation(k, demand[k], self._commanded.get_force_before_step(thrust, k))


NO_MODEL = "'condensed_box' or 'condensed_stacked', as these QPs have no model with states"


class BoxFormulation:
    """The condensed formulation of QPs, with box constraints, as the controller makes them.

    A solver is set up with q = 0, in a replay as in a closed loop, where no state is known yet. New
    matrices of a step become those of `base`, for later steps without any. The arrays of a step
    that go to the solver are its own.
    """

    def __init__(self, base: QuadraticProgram) -> None:
        self._base = base.for_setup()
        self._changed: dict[str, Matrix] = {}

    @property
    def base(self) -> QuadraticProgram:
        """The problem of the set-up, with the last matrices that a step brought."""
        if self._changed:
            vectors = self._base.q, self._base.l, self._base.u
            self._base, self._changed = self._base.at(QPStep(*vectors, **self._changed)), {}
        return self._base

    def step(self, step: QPStep) -> QPStep:
        """Return a step's QP for the solver, a copy after new matrices; store those for `base`."""
        # This is a part of emitting: asking the flag `refresh` takes half a microsecond, and a new
        # `base` three.
        if not (step.P is None and step.A is None and step.lb is None and step.ub is None):
            for name in CONSTANT:
                if (array := getattr(step, name)) is not None:
                    self._changed[name] = array
            return step.copy()
        return step

    def solution(self, answer: Solution) -> Solution:
        """Return a solver's answer as the answer to the condensed QP: here the same."""
        return answer


class StackedFormulation(BoxFormulation):
    """The formulation of QPs with all limits as one-sided rows, as in the paper (eq. 23-25)."""

    def __init__(self, base: QuadraticProgram) -> None:
        super().__init__(convert_qp_to_one_sided_rows(base))
        self._m = base.m

    def step(self, step: QPStep) -> QPStep:
        """Return a step's QP with all its limits as one-sided rows."""
        return super().step(convert_step_to_one_sided_rows(step, self.base))

    def solution(self, answer: Solution) -> Solution:
        """Return a solver's answer with the multipliers of each row's two sides joined."""
        return convert_solution_to_two_sided_rows(answer, self._m)


class SparseFormulation(BoxFormulation):
    """The sparse formulation of QPs, ordered by stages; `condensed` maps answers back."""

    def __init__(self, base: QuadraticProgram, condensed: Callable[[Solution], Solution]) -> None:
        super().__init__(base)
        self._condensed = condensed

    def solution(self, answer: Solution) -> Solution:
        """Return a solver's answer to the sparse QP as one to the condensed QP."""
        return self._condensed(answer)


def build_loop_formulation(
    formulation: Formulation, builder: QPBuilder, base: QuadraticProgram
) -> BoxFormulation:
    """Return the formulation, box, stacked or sparse, in which a loop's QPs go to the solver."""
    if builder.staged is None:
        return _build_condensed_formulation(formulation, base)
    model = builder.staged.control.model
    at_rest = np.zeros(model.n_x), np.zeros(model.n_y), np.zeros(model.n_u)
    staged = builder.staged
    return SparseFormulation(
        staged.problem(staged.emit(*at_rest)), staged.convert_solution_to_condensed
    )


def formulate_sequence(
    formulation: Formulation, sequence: QPSequence
) -> tuple[QPSequence, BoxFormulation]:
    """Return the QPs to replay and their formulation; InputError for "sparse" without a model."""
    if formulation != "sparse":
        return sequence, _build_condensed_formulation(formulation, sequence.base)
    if sequence.sparse_equivalent is None:
        raise InputError(f"sequence {sequence.name}", "formulation", "'sparse'", NO_MODEL)
    sparse = sequence.sparse_equivalent()
    return sparse.sequence, SparseFormulation(sparse.sequence.base, sparse.condensed)


def _build_condensed_formulation(
    formulation: Formulation, base: QuadraticProgram
) -> BoxFormulation:
    """Return the formulation of a condensed QP: one-sided rows only, or rows and a box."""
    return StackedFormulation(base) if formulation == "condensed_stacked" else BoxFormulation(base)


def convert_qp_to_one_sided_rows(qp: QuadraticProgram) -> QuadraticProgram:
    """Return a QP with two-sided rows and bounds as one with 2m + 2n one-sided rows M z ≤ γ."""
    identity = np.eye(qp.n)
    M = np.vstack([-qp.A, qp.A, -identity, identity])
    gamma = np.concatenate([-qp.l, qp.u, -qp.lb, qp.ub])
    free = np.full(qp.n, np.inf)
    none = np.full(len(gamma), -np.inf)
    return QuadraticProgram(qp.P, qp.q, M, none, gamma, -free, free, 0, qp.moves)


def convert_step_to_one_sided_rows(step: QPStep, stacked: QuadraticProgram) -> QPStep:
    """Return a QP's step for its one-sided form `stacked`, with M where the step has new rows."""
    m = step.l.shape[0]
    gamma = stacked.u.copy()
    np.negative(step.l, out=gamma[:m])
    gamma[m : 2 * m] = step.u
    M = None
    if step.A is not None:
        M = stacked.A.copy()
        np.negative(step.A, out=M[:m])
        M[m : 2 * m] = step.A
    n = stacked.n
    if step.lb is not None:
        np.negative(step.lb, out=gamma[2 * m : 2 * m + n])
    if step.ub is not None:
        gamma[2 * m + n :] = step.ub
    return QPStep(step.q, stacked.l.copy(), gamma, P=step.P, A=M)


def convert_solution_to_two_sided_rows(solution: Solution, m: int) -> Solution:
    """Return a solution of the one-sided QP as one of the two-sided QP with m rows."""
    n = solution.z.shape[0]
    lam = solution.y
    y, y_box = lam[m : 2 * m] - lam[:m], lam[2 * m + n :] - lam[2 * m : 2 * m + n]
    return solution.copy_with_other_vectors(solution.z, y, y_box)
