"""The paper's own method (eq. 30-32) as a solver: the active set by its multipliers.

The paper's E, F, M, γ are P, q, the signed rows of [I; A] and their limits. The method, its arrays
and an example to follow by hand are in `active_set.c`.
"""

from dpbench.solvers.contract import Policy, Route, make_error_for_missing_setup
from dpbench.solvers.own.compiled_workspace import REFUSED, CompiledWorkspace


class PaperActiveSetWorkspace(CompiledWorkspace):
    """The paper's active-set QP solver, in C; `warm` keeps the active set between steps."""

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self._solve = self._library.active_set_solve

    def solve(self) -> None:
        """Solve the current QP by one call of the C library."""
        if self._ending == REFUSED:
            return
        if self._problem is None:
            raise make_error_for_missing_setup("solve")
        self._ending = self._solve(self._pointer)
