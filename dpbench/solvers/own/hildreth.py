"""Hildreth's quadratic programming procedure: the dual coordinate method of textbook controllers.

C. Hildreth, "A quadratic programming procedure", Naval Research Logistics Quarterly 4 (1957) 79-85,
in the form of L. Wang, Model Predictive Control System Design and Implementation Using MATLAB
(Springer 2009), section 2.4.4, but with one multiplier of either sign for the two limits of a row.
Its defaults are those of Wang's `QPhild`: at most 38 sweeps, ended early when the squared change of
the multipliers is below 10e-8. That alone says little about the answer, so that a second criterion
can be set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dpbench.errors import SettingsError
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Policy, Route
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.compiled_workspace import CompiledWorkspace
from dpbench.solvers.own.hildreth_kernel import hildreth_step
from dpbench.solvers.own.safeguards.proof import contradicts


@dataclass(frozen=True)
class HildrethSettings:
    """When to stop.

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
    def of(cls, options: Mapping[str, object]) -> HildrethSettings:
        """From the solver's own keys; SettingsError for a value that is not a positive number."""
        for key, value in options.items():
            integer = key == "max_iter"
            if isinstance(value, bool) or not isinstance(value, int if integer else (int, float)):
                kind = "a whole number" if integer else "a number"
                raise SettingsError("settings of hildreth", key, repr(value), kind)
            if not value > 0:
                raise SettingsError("settings of hildreth", key, repr(value), "above 0")
        return cls(**options)  # type: ignore[arg-type] # checked above; keys by the caller


class Hildreth(CompiledWorkspace):
    """The method with its constant matrices, and under `warm` its multipliers, kept."""

    def __init__(
        self, solver: str, route: Route, policy: Policy, settings: HildrethSettings
    ) -> None:
        super().__init__(solver, route, policy)
        self._settings = settings

    def solve(self) -> None:
        """Sweeps until the criteria are met or the sweeps are used up."""
        if self._refusal or self._S is None:
            return self._cannot()
        s = self._settings
        self._ending = ending = hildreth_step(self._S, s.max_iter, s.eps_change, s.eps_row)
        if ending == layout.UNDECIDED or ending == layout.INFEASIBLE:
            self._unusual = self._unfinished()
        return None

    def _unfinished(self) -> Solution:
        """Multipliers that grow without end along a ray prove that there is no feasible point."""
        qp, S = self._problem(), self._S
        assert S is not None
        z, y, y_box = self._z.copy(), self._y.copy(), self._y_box.copy()
        dy, dy_box = y, y_box
        if self._ending == layout.UNDECIDED:
            n_pad = int(S[layout.HEAD, layout.N_PAD])
            dy = y - S[layout.BEFORE, n_pad : n_pad + qp.m]
            dy_box = y_box - S[layout.BEFORE, : qp.n]
        if contradicts(qp, dy, dy_box):
            self.reset()
            detail = "y and y_box are a Farkas ray"
            none = np.full(qp.n, np.nan)
            return Solution(Status.PRIMAL_INFEASIBLE, none, dy, dy_box, detail=detail)
        sweeps = int(S[layout.HEAD, layout.ITERATIONS])
        return Solution(Status.MAX_ITERATIONS, z, y, y_box, sweeps)
