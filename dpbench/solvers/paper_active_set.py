"""The paper's own method (eq. 30-32) as a solver: the active set by its multipliers.

The paper's E, F, M, γ are P, q, the signed rows of [I; A] and their limits. A step is one compiled
call of `active_set_kernel.py`; what rounding keeps that call from deciding is left to
`careful_active_set.py`.
"""

from __future__ import annotations

import numpy as np

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.solvers import active_set_layout as layout
from dpbench.solvers.active_set_kernel import solve_step
from dpbench.solvers.careful_active_set import solve_carefully
from dpbench.solvers.compiled_workspace import CompiledWorkspace
from dpbench.solvers.proof import cleaned, contradicts

INFEASIBLE = Status.PRIMAL_INFEASIBLE


def prime() -> None:
    """Load or compile what is compiled, so that no step of a run has to."""
    one = np.ones(1)
    workspace = PaperActiveSet("paper_active_set", "native", "reuse")
    workspace.setup(QuadraticProgram(np.eye(1), one, np.eye(1), -one, one, -one, one))
    workspace.solve()


class PaperActiveSet(CompiledWorkspace):
    """The paper's method with its constant matrices, and under `warm` its set, kept."""

    def solve(self) -> None:
        """One compiled call; `read` sees to endings other than an optimum."""
        if self._refusal or self._S is None:
            return self._cannot()
        self._ending = ending = solve_step(self._S)
        if ending == layout.UNDECIDED or ending == layout.INFEASIBLE:
            self._decide()
        return None

    def _decide(self) -> None:
        """Check the proof of a contradiction, and leave what is not clear to the careful method."""
        qp = self._problem()
        if self._ending == layout.INFEASIBLE:
            z = np.full(qp.n, np.nan)
            self._unusual = _proven(qp, Solution(INFEASIBLE, z, self._y, self._y_box))
        if self._ending == layout.UNDECIDED or self._unusual.status is not INFEASIBLE:
            self._unusual = _proven(qp, solve_carefully(qp))
        self._ending = layout.UNDECIDED


def _proven(qp: QuadraticProgram, answer: Solution) -> Solution:
    """The answer; a claim of infeasibility less the entries of its ray that are rounding.

    A claim that its ray does not bear out is withdrawn.
    """
    if answer.status is not INFEASIBLE:
        return answer
    y, y_box = cleaned(answer.y, answer.y_box)
    if contradicts(qp, y, y_box):
        return Solution(INFEASIBLE, answer.z, y, y_box, detail="y and y_box are a Farkas ray")
    detail = "the limits contradict each other by no more than rounding"
    return Solution.missing(qp.n, qp.m, Status.NUMERICAL_ERROR, detail)
