"""Common base of dpbench's own compiled solvers: all of a step but the solve.

The problem is kept in the memory of the C library (`library.Problem`); `solve` of a subclass is a
call on it and leaves its ending in `_ending`: the number of iterations, or a negative number.
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
from dpbench.solvers.own.library import (
    CROSSED,
    FAILED,
    INFEASIBLE,
    NOT_FINITE,
    REFUSALS,
    Problem,
    load_own_c_library,
)

SOLVED = Status.SOLVED
NOT_SOLVED_YET, REFUSED = -100, -101


class CompiledWorkspace(Workspace):
    """Base of dpbench's own compiled QP solvers, which keep QP and answer in the C library."""

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self.setup_every_step = policy == "fresh"
        self._library = load_own_c_library()
        self._problem: Problem | None = None
        self._refusal = 0
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
        self._factorise_or_store_refusal(problem)

    def _factorise_or_store_refusal(self, problem: Problem) -> None:
        """Have the C library factorise a QP's matrices; keep its refusal, if any."""
        arrays = problem.P_pointer, problem.A_pointer
        self._store_refusal_by_code(self._library.active_set_factorise(self._pointer, *arrays))

    def _store_refusal_by_code(self, code: int) -> None:
        """Store why the C library refused a QP, by its code; 0 for none."""
        self._refusal = code
        self._ending = self._ready = REFUSED if code else NOT_SOLVED_YET

    def update(self, step: QPStep) -> None:
        """Write a step's vectors and what else it brings; a new P is factorised."""
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
        """Write a step that brings matrices, bounds or other kinds of arrays; check its shapes."""
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
            self._write_new_matrices_into_library(step, problem)
        self._ending = self._ready

    def _write_new_matrices_into_library(self, step: QPStep, problem: Problem) -> None:
        """Have the library take over new matrices; where P is that of before, its factor stays."""
        self.matrix_updates += 1
        if step.P is not None or self._refusal:
            self._factorise_or_store_refusal(problem)
        elif step.A is not None:
            replace_rows = self._library.active_set_replace_rows
            self._store_refusal_by_code(replace_rows(self._pointer, problem.A_pointer))

    def read(self) -> Solution:
        """Return the last solve's answer, copied, with a status that says how it ended."""
        ending = self._ending
        if ending >= 0:
            return Solution(SOLVED, self._z.copy(), self._y.copy(), self._y_box.copy(), ending)
        if self._problem is None:
            raise make_error_for_missing_setup("read")
        if ending == NOT_SOLVED_YET:
            return self._make_solution_without_point(Status.ERROR, "read before solve")
        if ending == REFUSED:
            return self._make_solution_without_point(Status.ERROR, REFUSALS[self._refusal])
        if ending == NOT_FINITE:
            return self._make_solution_without_point(Status.ERROR, "q is not finite")
        if ending == CROSSED:
            return self._make_solution_of_bad_limits()
        if ending == INFEASIBLE:
            answer = self._make_solution_without_point(
                Status.PRIMAL_INFEASIBLE, "y and y_box are a Farkas ray"
            )
            answer.y, answer.y_box = self._y.copy(), self._y_box.copy()
            return answer
        if ending == FAILED:
            sentence = "rounding leaves no point near the optimality conditions"
            return self._make_solution_without_point(Status.NUMERICAL_ERROR, sentence)
        return self._make_solution_of_unfinished_solve(
            self._z.copy(), self._y.copy(), self._y_box.copy(), self._problem.head.iterations
        )

    def _make_solution_of_unfinished_solve(
        self, z: np.ndarray, y: np.ndarray, y_box: np.ndarray, iterations: int
    ) -> Solution:
        """Return the answer of a solve that ended near an optimum, as INACCURATE."""
        detail = "where the optimum is depends on rounding"
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
