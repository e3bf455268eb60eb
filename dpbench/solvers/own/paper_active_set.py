"""The paper's own method (eq. 30-32) as a solver: the active set by its multipliers.

The paper's E, F, M, γ are P, q, the signed rows of [I; A] and their limits. The method, its arrays
and an example to follow by hand are in `active_set.c`. The problem is kept in the memory of the C
library (`library.Problem`), for other methods too: a subclass has its own `solve`.
"""

from typing import Any

import numpy as np

from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import (
    Policy,
    Route,
    Workspace,
    check_step,
    make_error_for_missing_setup,
)
from dpbench.solvers.own.library import Problem, load_own_c_library

SOLVED = Status.SOLVED
NOT_SOLVED_YET, CROSSED, INFEASIBLE = -100, -2, -3
ENDINGS = {
    -1: (Status.ERROR, "q is not finite"),
    INFEASIBLE: (Status.PRIMAL_INFEASIBLE, "y and y_box are a Farkas ray"),
    -5: (Status.NUMERICAL_ERROR, "rounding leaves no point near the optimality conditions"),
    NOT_SOLVED_YET: (Status.ERROR, "read before solve"),
    NOT_SOLVED_YET - 1: (Status.ERROR, "P or A is not finite"),
    NOT_SOLVED_YET - 2: (Status.ERROR, "P is not positive definite"),
}
"""Endings without a point: those of a solve by `active_set.h`, and refusals of the matrices."""


class PaperActiveSetWorkspace(Workspace):
    """The paper's active-set QP solver, in C; `warm` keeps the active set between steps.

    `_ending` is the last solve's number of iterations, or a negative number; `_ready` is that of
    matrices taken over, below NOT_SOLVED_YET if they were refused.
    """

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self.setup_every_step = policy == "fresh"
        self._library = load_own_c_library()
        self._solve = self._library.active_set_solve
        self._problem: Problem | None = None
        self._ending = self._ready = NOT_SOLVED_YET
        self._q_view: Any
        self._low_view: Any
        self._high_view: Any

    def setup(self, qp: QuadraticProgram) -> None:
        """Write `qp` into the library; if P is not positive definite, solving ends in ERROR."""
        n, m, problem = qp.n, qp.m, self._problem
        if problem is None or problem.P.shape != (n, n) or problem.A.shape != (m, n):
            self._problem = problem = Problem(n, m)
            self._pointer, self._q, self._z = problem.pointer, problem.q, problem.z
            self._low, self._high = problem.low[n:], problem.high[n:]
            self._y, self._y_box = problem.lam[n:], problem.lam[:n]
            vectors = self._q, self._low, self._high
            self._q_view, self._low_view, self._high_view = (v.data for v in vectors)
        problem.head.warm, problem.head.block = self.policy == "warm", qp.block
        problem.P[:], problem.A[:] = qp.P, qp.A
        problem.low[:n], problem.high[:n] = qp.lb, qp.ub
        self._q[:], self._low[:], self._high[:] = qp.q, qp.l, qp.u
        problem.head.stale = 1
        self._factorise(problem)

    def _factorise(self, problem: Problem) -> None:
        """Have the C library factorise a QP's matrices; store its refusal, if any."""
        arrays = problem.P_pointer, problem.A_pointer
        refusal = self._library.active_set_factorise(self._pointer, *arrays)
        self._ending = self._ready = NOT_SOLVED_YET - refusal

    def update(self, step: QPStep) -> None:
        """Write a step's vectors, and what else it brings, into the library; factorise a new P."""
        if step.P is None and step.A is None and step.lb is None and step.ub is None:
            try:
                # Assigning to a memoryview is faster than NumPy and refuses another shape or type.
                self._q_view[:], self._low_view[:], self._high_view[:] = step.q, step.l, step.u
                self._ending = self._ready
                return
            except (AttributeError, ValueError, TypeError):
                pass
        self._update_with_shape_checks(step)

    def _update_with_shape_checks(self, step: QPStep) -> None:
        """Write a step that brings matrices or bounds into the library; ShapeError if unfit."""
        problem = self._problem
        if problem is None:
            raise make_error_for_missing_setup("update")
        n = len(self._q)
        pairs = (self._q, step.q), (self._low, step.l), (self._high, step.u), (problem.P, step.P)
        others = (problem.A, step.A), (problem.low[:n], step.lb), (problem.high[:n], step.ub)
        for array, new in (*pairs, *others):
            if new is not None:
                if new.shape != array.shape:
                    check_step(step, n, len(self._low))
                array[:] = new
        if step.refresh is not Refresh.VECTORS:
            self.matrix_updates += 1
            if step.P is not None or self._ready < NOT_SOLVED_YET:
                self._factorise(problem)
            elif step.A is not None:
                replace_rows = self._library.active_set_replace_rows
                self._ready = NOT_SOLVED_YET - replace_rows(self._pointer, problem.A_pointer)
        self._ending = self._ready

    def solve(self) -> None:
        """Solve the current QP by one call of the C library, which stores the answer."""
        if self._ending < NOT_SOLVED_YET:
            return
        if self._problem is None:
            raise make_error_for_missing_setup("solve")
        self._ending = self._solve(self._pointer)

    def read(self) -> Solution:
        """Return the last solve's answer, copied, with a status that says how it ended."""
        ending = self._ending
        if ending >= 0:
            return Solution(SOLVED, self._z.copy(), self._y.copy(), self._y_box.copy(), ending)
        if self._problem is None:
            raise make_error_for_missing_setup("read")
        if ending == CROSSED:
            return self._make_solution_of_bad_limits()
        if ending not in ENDINGS:
            return self._make_solution_of_unfinished_solve(
                self._z.copy(), self._y.copy(), self._y_box.copy(), self._problem.head.iterations
            )
        answer = self._make_solution_without_point(*ENDINGS[ending])
        if ending == INFEASIBLE:
            answer.y, answer.y_box = self._y.copy(), self._y_box.copy()
        return answer

    def _make_solution_of_unfinished_solve(
        self, z: np.ndarray, y: np.ndarray, y_box: np.ndarray, iterations: int
    ) -> Solution:
        """Return the answer of a solve that ended near an optimum, as INACCURATE."""
        detail = "the position of the optimum depends on rounding"
        return Solution(Status.INACCURATE, z, y, y_box, iterations, detail=detail)

    def _make_solution_of_bad_limits(self) -> Solution:
        """Return PRIMAL_INFEASIBLE with a proof for limits that cross, ERROR for NaN limits."""
        assert self._problem is not None
        n = len(self._q)
        low, high = (
            np.concatenate([a[n:], a[:n]]) for a in (self._problem.low, self._problem.high)
        )
        if np.isnan(low).any() or np.isnan(high).any():
            return self._make_solution_without_point(Status.ERROR, "a limit is NaN")
        row = np.flatnonzero((low > high) | (low == np.inf) | (high == -np.inf))[0]
        answer = self._make_solution_without_point(
            Status.PRIMAL_INFEASIBLE, f"the limits of row {row} of [A; I] cross"
        )
        proof = np.zeros(low.size)
        proof[row] = 1.0
        answer.y, answer.y_box = proof[:-n], proof[-n:]
        return answer

    def _make_solution_without_point(self, status: Status, detail: str) -> Solution:
        """Return an answer without a point, with a status and its detail."""
        return Solution.without_point(len(self._q), len(self._low), status, detail)

    def reset(self) -> None:
        """Make the next solve start without a warm start, from an empty active set."""
        if self._problem is not None:
            self._problem.head.stale = 1
