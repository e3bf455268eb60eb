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
from dpbench.solvers.own.active_set.constants import constraints, empty, fill, results, vectors
from dpbench.solvers.own.active_set.kernel import take_over, take_over_rows

SOLVED = Status.SOLVED
NOT_SOLVED_YET = -100


class CompiledWorkspace(Workspace):
    """A workspace on S; under policy `warm` what a solve leaves there starts the next one."""

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
        """Write the constants of `qp`.

        A P that is not positive definite shows as ERROR when solved.
        """
        self._prepare(qp.copy())

    def _prepare(self, qp: QuadraticProgram) -> None:
        before, n, m = self._base, qp.n, qp.m
        self._base, self._others, self._ending = qp, False, NOT_SOLVED_YET
        if self._S is None or before is None or (before.n, before.m) != (n, m):
            self._S = empty(n, m)
            self._z, self._y, self._y_box = results(self._S, n, m)
            self._constraints = constraints(self._S, n, m)
        self._refusal = fill(self._S, qp, keep=self.policy == "warm")

    def update(self, step: QPStep) -> None:
        """Take over the vectors, and rows of A that changed; a new P is factorised."""
        self._ending = NOT_SOLVED_YET
        if step.P is None and step.lb is None and step.ub is None and not self._refusal:
            try:
                A, taken = step.A, take_over(self._S, step.q, step.l, step.u)
                if taken and (A is None or self._take_over_rows(A)):
                    return
            except TypeError:  # arrays of another kind, or no setup yet
                pass
        self._update_slowly(step)

    def _take_over_rows(self, A: Matrix) -> bool:
        """Whether A has been taken over without factorising P again."""
        taken: bool = take_over_rows(self._S, A)
        # Only what is unusual asks for the problem as a whole.
        self._others = self._others or taken
        self.matrix_updates += taken
        return taken

    def _update_slowly(self, step: QPStep) -> None:
        """Arrays of another layout or type, new matrices, or a mistake."""
        base = self._base
        if base is None or self._S is None:
            raise missing_setup_error("update")
        check_step(step, base.n, base.m)
        if step.refresh is Refresh.VECTORS:
            kept = vectors(self._S, base.n, base.m)
            for vector, new in zip(kept, (step.q, step.l, step.u), strict=True):
                vector[:] = new
        else:
            self.matrix_updates += 1
            self._prepare(self._known(base).at(step).copy())

    def _cannot(self) -> None:
        if self._base is None:
            raise missing_setup_error("solve")
        self._unusual = self._missing(Status.ERROR, self._refusal)
        self._ending = layout.UNDECIDED

    def read(self) -> Solution:
        """Return the answer; every call gives it in new memory."""
        ending = self._ending
        if ending >= 0:
            return Solution(SOLVED, self._z.copy(), self._y.copy(), self._y_box.copy(), ending)
        if ending == NOT_SOLVED_YET:
            return self._missing(Status.ERROR, "read before solve")
        if ending == layout.NOT_FINITE:
            return self._missing(Status.ERROR, "q is not finite")
        if ending == layout.CROSSED:
            return self._crossed()
        answer = self._unusual
        return answer.with_iterate(answer.z.copy(), answer.y.copy(), answer.y_box.copy())

    def _crossed(self) -> Solution:
        """Limits that contradict each other on their own, or are no numbers."""
        qp = self._problem()
        low, high = qp.limits()
        if np.isnan(low).any() or np.isnan(high).any():
            return self._missing(Status.ERROR, "a limit is NaN")
        row = np.flatnonzero((low > high) | (low == np.inf) | (high == -np.inf))[0]
        answer = self._missing(Status.PRIMAL_INFEASIBLE, f"the limits of row {row} of [A; I] cross")
        proof = np.zeros(low.size)
        proof[row] = 1.0
        answer.y, answer.y_box = proof[: qp.m], proof[qp.m :]
        return answer

    def _problem(self) -> QuadraticProgram:
        """Return the current problem, in memory of its own."""
        assert self._base is not None and self._S is not None
        base = self._known(self._base)
        q, low, high = (array.copy() for array in vectors(self._S, base.n, base.m))
        return QuadraticProgram(base.P, q, base.A, low, high, base.lb, base.ub, base.block)

    def _known(self, base: QuadraticProgram) -> QuadraticProgram:
        """Return the problem of the set-up, with the rows that were taken over since."""
        if self._others and self._S is not None:
            base = self._base = replace(base, A=self._constraints[0].copy())
            self._others = False
        return base

    def _missing(self, status: Status, detail: str) -> Solution:
        if self._base is None:
            raise missing_setup_error("read")
        return Solution.missing(self._base.n, self._base.m, status, detail)

    def reset(self) -> None:
        """Start the next solve from the empty set."""
        if self._S is not None:
            self._S[layout.HEAD, layout.STALE] = 1.0
