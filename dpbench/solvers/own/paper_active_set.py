"""The paper's own method (eq. 30-32) as a solver: the active set by its multipliers.

The paper's E, F, M, γ are P, q, the signed rows of [I; A] and their limits. A step is one compiled
call of `active_set.kernel`; what rounding keeps that call from deciding is left to
`proof.solve_carefully`. No answer of either is called solved that misses the optimality conditions
of `active_set.check`, or whose place rounding decides (`exact_point.moves_under_small_shifts`).
"""

from math import inf

import numpy as np

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.joint import JointQP
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.check import WRONG
from dpbench.solvers.own.active_set.kernel import optimality_excess, solve_step
from dpbench.solvers.own.compiled_workspace import CompiledWorkspace
from dpbench.solvers.own.exact_point import (
    error_bound,
    error_units,
    is_regular_vertex,
    moves_under_small_shifts,
)
from dpbench.solvers.own.proof import (
    drop_ray_rounding,
    has_consistent_equalities,
    is_infeasibility_proof,
    proves_infeasible,
    solve_carefully,
)

INFEASIBLE = Status.PRIMAL_INFEASIBLE
RAY = "y and y_box are a Farkas ray"
USABLE = 1e4
"""An answer that misses the optimality conditions by up to this many times what is allowed is
given as inaccurate: 1e-6 of a row's terms, 1e-4 of 1 + ‖q‖ at most."""


class PaperActiveSetWorkspace(CompiledWorkspace):
    """The paper's active-set QP solver, compiled; `warm` keeps the active set between steps."""

    def solve(self) -> None:
        """Solve the current QP by the compiled active-set method; verify unclear results."""
        if self._refusal or self._S is None:
            return self._refuse_to_solve()
        self._ending = ending = solve_step(self._S)
        if ending < layout.CROSSED:
            self._resolve_unclear_ending(ending)
        return None

    def _resolve_unclear_ending(self, ending: int) -> None:
        """Verify a claim of infeasibility, or solve again by a more exact active-set method."""
        assert self._S is not None
        self._ending = layout.UNDECIDED
        if ending == layout.INFEASIBLE and self._has_infeasibility_proof():
            return None
        qp = self._copy_current_problem()
        if ending == layout.DOUBTFUL:
            return self._accept_answer(qp, int(self._S[layout.HEAD, layout.ITERATIONS]))
        careful = solve_carefully(qp)
        if careful.status is INFEASIBLE:
            self._unusual = _check_infeasibility_claim(qp, careful)
            if self._unusual.status is INFEASIBLE:
                return None
            careful = solve_carefully(qp, contradiction=np.inf)
        return self._grade_by_optimality(qp, careful)

    def _has_infeasibility_proof(self) -> bool:
        """Return whether the computed Farkas ray proves infeasibility."""
        y, y_box = self._y.copy(), self._y_box.copy()
        drop_ray_rounding(y, y_box)
        if not is_infeasibility_proof(*self._constraints, y, y_box):
            return False
        self._unusual = Solution(INFEASIBLE, np.full(len(y_box), np.nan), y, y_box, detail=RAY)
        return True

    def _grade_by_optimality(self, qp: QuadraticProgram, answer: Solution) -> None:
        """Record an answer as solved, inaccurate or failed by its optimality residuals."""
        assert self._S is not None
        self._z[:], self._y[:], self._y_box[:] = answer.z, answer.y, answer.y_box
        excess = optimality_excess(self._S)
        if excess <= 1.0:
            return self._accept_answer(qp, answer.iterations)
        detail = f"the optimality conditions are missed by {excess:.1e} times what is allowed"
        if excess <= USABLE:
            answer.status, answer.detail = Status.INACCURATE, detail
        elif answer.status is Status.SOLVED:
            answer = self._make_empty_solution(Status.NUMERICAL_ERROR, detail)
        self._unusual = answer
        return None

    def _accept_answer(self, qp: QuadraticProgram, iterations: int) -> None:
        """Accept an answer as solved; as INACCURATE if it may be far from the optimum."""
        detail = self._reason_to_doubt(qp)
        if detail:
            z, y, y_box = self._z.copy(), self._y.copy(), self._y_box.copy()
            self._unusual = Solution(Status.INACCURATE, z, y, y_box, iterations, detail=detail)
        else:
            self._ending = iterations

    def _reason_to_doubt(self, qp: QuadraticProgram) -> str:
        """Return why the answer may be far from the optimum, as text; "" if it is near."""
        assert self._S is not None
        if not has_consistent_equalities(qp):
            return "rows with equal limits depend on one another but for rounding"
        posed, sensitive = JointQP.of(qp), moves_under_small_shifts(self._S, qp)
        if not sensitive and is_regular_vertex(posed, self._z):
            return ""
        bound = error_bound(posed, self._z, np.concatenate([self._y, self._y_box]))
        # A point that satisfies all limits to the last bit is asked for where it can be found.
        if bound <= WRONG * error_units(qp).min() or (bound != inf and not sensitive):
            return ""
        return "where the optimum is depends on the rounding of limits"


def _check_infeasibility_claim(qp: QuadraticProgram, answer: Solution) -> Solution:
    """Return an infeasible answer if its Farkas ray is a proof, else NUMERICAL_ERROR."""
    if answer.status is not INFEASIBLE:
        return answer
    y, y_box = answer.y.copy(), answer.y_box.copy()
    drop_ray_rounding(y, y_box)
    if proves_infeasible(qp, y, y_box):
        return Solution(INFEASIBLE, answer.z, y, y_box, detail=RAY)
    detail = "the limits contradict each other by no more than rounding"
    return Solution.missing(qp.n, qp.m, Status.NUMERICAL_ERROR, detail)
