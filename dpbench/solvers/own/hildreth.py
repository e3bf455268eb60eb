"""Hildreth's quadratic programming procedure: the dual coordinate method of textbook controllers.

The procedure, its sources and an example to follow by hand are in `hildreth.c`. Its defaults are
those of `QPhild` in Wang's textbook (2009): at most 38 sweeps, ended early when the squared change
of the multipliers is below 10e-8. That alone says little about the answer, so that a second
criterion can be set.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dpbench.errors import SettingsError
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Policy, Route, make_error_for_missing_setup
from dpbench.solvers.own.paper_active_set import NOT_SOLVED_YET, PaperActiveSetWorkspace


@dataclass(frozen=True)
class HildrethSettings:
    """Stopping criteria of Hildreth's method.

    Parameters
    ----------
    max_iter : sweeps over all multipliers.
    eps_change : ‖Δλ‖² of a sweep below which it has converged; Wang's 10e-8.
    eps_row : the most that a sweep may still move a row of [A; I] z; Wang does not ask.
    """

    max_iter: int = 38
    eps_change: float = 10e-8
    eps_row: float = np.inf

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> "HildrethSettings":
        """Return stopping criteria of solver options; SettingsError unless all are positive."""
        for key, value in options.items():
            integer = key == "max_iter"
            if isinstance(value, bool) or not isinstance(value, int if integer else (int, float)):
                kind = "a whole number" if integer else "a number"
                raise SettingsError("settings of hildreth", key, repr(value), kind)
            if not value > 0:
                raise SettingsError("settings of hildreth", key, repr(value), "above 0")
        return cls(**options)  # type: ignore[arg-type] # checked above; keys by the caller


class HildrethWorkspace(PaperActiveSetWorkspace):
    """Hildreth's dual method as QP solver; `warm` keeps the multipliers between steps."""

    def __init__(
        self, solver: str, route: Route, policy: Policy, settings: HildrethSettings
    ) -> None:
        super().__init__(solver, route, policy)
        self._criteria = settings.max_iter, settings.eps_change, settings.eps_row
        self._change = np.zeros(0)

    def solve(self) -> None:
        """Run Hildreth's method until it converges or reaches the sweep limit; store the answer."""
        if self._ending < NOT_SOLVED_YET:
            return
        if self._problem is None:
            raise make_error_for_missing_setup("solve")
        if self._change.size != self._problem.lam.size:
            self._change = np.zeros_like(self._problem.lam)
            self._change_pointer = self._change.ctypes.data
        solve = self._library.hildreth_solve
        self._ending = solve(self._pointer, *self._criteria, self._change_pointer)

    def _make_solution_of_unfinished_solve(
        self, z: np.ndarray, y: np.ndarray, y_box: np.ndarray, iterations: int
    ) -> Solution:
        """Return what the sweeps have reached, as MAX_ITERATIONS."""
        return Solution(Status.MAX_ITERATIONS, z, y, y_box, iterations)
