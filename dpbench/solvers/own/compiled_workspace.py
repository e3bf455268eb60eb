"""Common base of dpbench's own compiled solvers: all of a step but the solve.

The problem is kept as the array S of `active_set.layout`; `solve` of a subclass is a compiled
call on it and leaves its ending in `_ending`: the number of iterations, or a negative number.
"""

from dataclasses import replace

import numpy as np

from dpbench.arrays import Matrix
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Policy, Route, Workspace, check_step, missing_setup_error
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.constants import (
    constraint_views,
    new_problem_array,
    result_views,
    vector_views,
    write_problem,
)
from dpbench.solvers.own.active_set.kernel import replace_row_matrix, write_vectors

SOLVED = Status.SOLVED
NOT_SOLVED_YET = -100


class CompiledWorkspace(Workspace):
    """Base of dpbench's own compiled QP solvers, which keep QP and answer in one work array."""

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self.setup_every_step = policy == "fresh"
        self._base: QuadraticProgram | None = None
        self._S: Matrix | None = None
        self._others = False
        self._refusal = ""
        self._ending = NOT_SOLVED_YET
        self._unusual: Solution

    def setup(self, qp: QuadraticProgram) -> None:
        """Write `qp` into the work array; if P is not positive definite, solving ends in ERROR."""
        self._write_problem(qp.copy())

    def _write_problem(self, qp: QuadraticProgram) -> None:
        """Write `qp` into the work array, allocating a new one if the size differs."""
        before, n, m = self._base, qp.n, qp.m
        self._base, self._others, self._ending = qp, False, NOT_SOLVED_YET
        if self._S is None or before is None or (before.n, before.m) != (n, m):
            self._S = new_problem_array(n, m)
            self._z, self._y, self._y_box = result_views(self._S, n, m)
            self._constraints = constraint_views(self._S, n, m)
        self._refusal = write_problem(self._S, qp, keep=self.policy == "warm")

    def update(self, step: QPStep) -> None:
        """Write a step's vectors and changed rows of A; factorise P again if it is new."""
        self._ending = NOT_SOLVED_YET
        if step.P is None and step.lb is None and step.ub is None and not self._refusal:
            try:
                A, taken = step.A, write_vectors(self._S, step.q, step.l, step.u)
                if taken and (A is None or self._try_row_update(A)):
                    return
            except TypeError:  # arrays of another kind, or no setup yet
                pass
        self._update_slowly(step)

    def _try_row_update(self, A: Matrix) -> bool:
        """Write new rows of A without factorising P; return whether that was possible."""
        taken: bool = replace_row_matrix(self._S, A)
        # Only what is unusual asks for the problem as a whole.
        self._others = self._others or taken
        self.matrix_updates += taken
        return taken

    def _update_slowly(self, step: QPStep) -> None:
        """Write a step that changes P or bounds or has other array types; check its shapes."""
        base = self._base
        if base is None or self._S is None:
            raise missing_setup_error("update")
        check_step(step, base.n, base.m)
        if step.refresh is Refresh.VECTORS:
            kept = vector_views(self._S, base.n, base.m)
            for vector, new in zip(kept, (step.q, step.l, step.u), strict=True):
                vector[:] = new
        else:
            self.matrix_updates += 1
            self._write_problem(self._base_with_current_rows(base).at(step).copy())

    def _refuse_to_solve(self) -> None:
        """Store an ERROR answer with the reason why the problem cannot be solved."""
        if self._base is None:
            raise missing_setup_error("solve")
        self._unusual = self._make_empty_solution(Status.ERROR, self._refusal)
        self._ending = layout.UNDECIDED

    def read(self) -> Solution:
        """Return a copy of the answer, with a status that says how the solve ended."""
        ending = self._ending
        if ending >= 0:
            return Solution(SOLVED, self._z.copy(), self._y.copy(), self._y_box.copy(), ending)
        if ending == NOT_SOLVED_YET:
            return self._make_empty_solution(Status.ERROR, "read before solve")
        if ending == layout.NOT_FINITE:
            return self._make_empty_solution(Status.ERROR, "q is not finite")
        if ending == layout.CROSSED:
            return self._make_crossed_limits_solution()
        answer = self._unusual
        return answer.with_iterate(answer.z.copy(), answer.y.copy(), answer.y_box.copy())

    def _make_crossed_limits_solution(self) -> Solution:
        """Return PRIMAL_INFEASIBLE with a proof for limits that cross, ERROR for NaN limits."""
        qp = self._copy_current_problem()
        low, high = qp.limits()
        if np.isnan(low).any() or np.isnan(high).any():
            return self._make_empty_solution(Status.ERROR, "a limit is NaN")
        row = np.flatnonzero((low > high) | (low == np.inf) | (high == -np.inf))[0]
        answer = self._make_empty_solution(
            Status.PRIMAL_INFEASIBLE, f"the limits of row {row} of [A; I] cross"
        )
        proof = np.zeros(low.size)
        proof[row] = 1.0
        answer.y, answer.y_box = proof[: qp.m], proof[qp.m :]
        return answer

    def _copy_current_problem(self) -> QuadraticProgram:
        """Return a copy of the QP that is to be solved, from the work array."""
        assert self._base is not None and self._S is not None
        base = self._base_with_current_rows(self._base)
        q, low, high = (array.copy() for array in vector_views(self._S, base.n, base.m))
        return QuadraticProgram(base.P, q, base.A, low, high, base.lb, base.ub, base.block)

    def _base_with_current_rows(self, base: QuadraticProgram) -> QuadraticProgram:
        """Return the QP given to `setup`, with the rows of A that have changed since."""
        if self._others and self._S is not None:
            base = self._base = replace(base, A=self._constraints[0].copy())
            self._others = False
        return base

    def _make_empty_solution(self, status: Status, detail: str) -> Solution:
        """Return an answer of NaN with a given status and explanation."""
        if self._base is None:
            raise missing_setup_error("read")
        return Solution.missing(self._base.n, self._base.m, status, detail)

    def reset(self) -> None:
        """Make the next solve start without a warm start, from an empty active set."""
        if self._S is not None:
            self._S[layout.HEAD, layout.STALE] = 1.0
