"""The paper's own method (eq. 30-32) as a solver: the active set by its multipliers.

The paper's E, F, M, γ are P, q, the signed rows of [I; A] and their limits. A step is one compiled
call of `active_set.kernel`; what rounding keeps that call from deciding is left to
`proof.solve_carefully`, and no answer of either is called solved that misses the optimality
conditions of `active_set.check`, or whose place rounding decides (`exact_point.is_sensitive`).
"""

from math import inf

import numpy as np

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.joint import JointQP
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.check import WRONG
from dpbench.solvers.own.active_set.kernel import excess_of, solve_step
from dpbench.solvers.own.compiled_workspace import CompiledWorkspace
from dpbench.solvers.own.exact_point import error_bound, is_regular, is_sensitive, unit_of
from dpbench.solvers.own.proof import clean, contradicts, determined, is_proof, solve_carefully

INFEASIBLE = Status.PRIMAL_INFEASIBLE
RAY = "y and y_box are a Farkas ray"
USABLE = 1e4
"""An answer that misses the optimality conditions by up to this many times what is allowed is
given as inaccurate: 1e-6 of a row's terms, 1e-4 of 1 + ‖q‖ at most."""


class PaperActiveSet(CompiledWorkspace):
    """The paper's method with its constant matrices, and under `warm` its set, kept."""

    def solve(self) -> None:
        """Solve the current problem, as a rule in one compiled call; raises before a setup."""
        if self._refusal or self._S is None:
            return self._cannot()
        self._ending = ending = solve_step(self._S)
        if ending < layout.CROSSED:
            self._decide(ending)
        return None

    def _decide(self, ending: int) -> None:
        """Check the proof of a contradiction, and leave what is not clear to the careful method."""
        assert self._S is not None
        self._ending = layout.UNDECIDED
        if ending == layout.INFEASIBLE and self._is_proven():
            return None
        qp = self._problem()
        if ending == layout.DOUBTFUL:
            return self._solved(qp, int(self._S[layout.HEAD, layout.ITERATIONS]))
        careful = solve_carefully(qp)
        if careful.status is INFEASIBLE:
            self._unusual = _proven(qp, careful)
            if self._unusual.status is INFEASIBLE:
                return None
            careful = solve_carefully(qp, contradiction=np.inf)
        return self._judge(qp, careful)

    def _is_proven(self) -> bool:
        """Whether the ray in S proves that the problem there has no feasible point."""
        y, y_box = self._y.copy(), self._y_box.copy()
        clean(y, y_box)
        if not is_proof(*self._constraints, y, y_box):
            return False
        self._unusual = Solution(INFEASIBLE, np.full(len(y_box), np.nan), y, y_box, detail=RAY)
        return True

    def _judge(self, qp: QuadraticProgram, answer: Solution) -> None:
        """Solved, inaccurate or neither, by the optimality conditions and not by how it ended."""
        assert self._S is not None
        self._z[:], self._y[:], self._y_box[:] = answer.z, answer.y, answer.y_box
        excess = excess_of(self._S)
        if excess <= 1.0:
            return self._solved(qp, answer.iterations)
        detail = f"the optimality conditions are missed by {excess:.1e} times what is allowed"
        if excess <= USABLE:
            answer.status, answer.detail = Status.INACCURATE, detail
        elif answer.status is Status.SOLVED:
            answer = self._missing(Status.NUMERICAL_ERROR, detail)
        self._unusual = answer
        return None

    def _solved(self, qp: QuadraticProgram, iterations: int) -> None:
        """Keep the answer in S, which meets the optimality conditions.

        INACCURATE where that does not show it to be near the optimum.
        """
        detail = self._doubt(qp)
        if detail:
            z, y, y_box = self._z.copy(), self._y.copy(), self._y_box.copy()
            self._unusual = Solution(Status.INACCURATE, z, y, y_box, iterations, detail=detail)
        else:
            self._ending = iterations

    def _doubt(self, qp: QuadraticProgram) -> str:
        """Why the answer in S may not be near the optimum; "" if it is."""
        assert self._S is not None
        if not determined(qp):
            return "rows with equal limits depend on one another but for rounding"
        posed, sensitive = JointQP.of(qp), is_sensitive(self._S, qp)
        if not sensitive and is_regular(posed, self._z):
            return ""
        bound = error_bound(posed, self._z, np.concatenate([self._y, self._y_box]))
        # A point that satisfies all limits to the last bit is asked for where it can be found.
        if bound <= WRONG * unit_of(qp).min() or (bound != inf and not sensitive):
            return ""
        return "where the optimum is depends on the rounding of limits"


def _proven(qp: QuadraticProgram, answer: Solution) -> Solution:
    """Return the answer, a ray of infeasibility less those of its entries that are rounding.

    A claim that its ray does not bear out is withdrawn.
    """
    if answer.status is not INFEASIBLE:
        return answer
    y, y_box = answer.y.copy(), answer.y_box.copy()
    clean(y, y_box)
    if contradicts(qp, y, y_box):
        return Solution(INFEASIBLE, answer.z, y, y_box, detail=RAY)
    detail = "the limits contradict each other by no more than rounding"
    return Solution.missing(qp.n, qp.m, Status.NUMERICAL_ERROR, detail)
