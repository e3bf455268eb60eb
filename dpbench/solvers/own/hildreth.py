"""Hildreth's quadratic programming procedure: the dual coordinate method of textbook controllers.

C. Hildreth, "A quadratic programming procedure", Naval Research Logistics Quarterly 4 (1957) 79-85,
in the form of L. Wang, Model Predictive Control System Design and Implementation Using MATLAB
(Springer 2009), section 2.4.4, but with one multiplier of either sign for the two limits of a row.
Its defaults are those of Wang's `QPhild`: at most 38 sweeps, ended early when the squared change of
the multipliers is below 10e-8. That alone says little about the answer, so that a second criterion
can be set.

With v = C z and H = C P⁻¹ Cᵀ as in the active-set method, the multipliers are visited one after the
other, and each is set to the value that is best while the others stay:

    own = v_i + H_ii λ_i
    λ_i = (own − u_i)/H_ii if own > u_i,  (own − l_i)/H_ii if own < l_i,  else 0

Of the array S (`active_set.layout`) only H, K, the limits and V0, V, LAM, Z take part; BEFORE keeps
the multipliers of the sweep before.

An example to follow by hand: the point nearest (2, 2) under z₁ ≤ ½ and z₁ + z₂ ≤ 2, rows 0 and 16
of C, with H = [1 1; 1 2] on them. In a sweep each row is met in turn:

    sweep    row 0: λ₀ so that z₁ = ½      row 16: λ₁₆ so that z₁ + z₂ = 2    z = (2, 2) − Cᵀλ
    1        2 − ½          = 1.5          (½ + 2 − 2)/2         = 0.25       (0.25, 1.75)
    2        0.25 + 1.5 − ½ = 1.25         (½ + 1.75 + ½ − 2)/2  = 0.375      (0.375, 1.625)
    k        1 + 2^−k                      ½ − 2^−(k+1)                       → (½, 1.5)

>>> import numpy as np
>>> from dpbench.qp.program import QuadraticProgram
>>> from dpbench.solvers.own.active_set.constants import new_problem_array, write_problem
>>> none = np.full(2, np.inf)
>>> limits = [-np.inf], [2], -none, [0.5, np.inf]
>>> S = new_problem_array(n=2, m=1)
>>> write_problem(S, QuadraticProgram(np.eye(2), [-2, -2], [[1, 1]], *limits), keep=False)
''
>>> def multipliers_after(sweeps):
...     hildreth_step(S, sweeps, 0.0, 0.0)
...     return S[LAM, [0, 16]].tolist()
>>> multipliers_after(1), multipliers_after(2)
([1.5, 0.25], [1.25, 0.375])
>>> multipliers_after(10) == [1 + 2**-10, 0.5 - 2**-11]
True
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpbench.arrays import Matrix
from dpbench.errors import SettingsError
from dpbench.kernel_cache import njit
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Policy, Route
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.layout import (
    BEFORE,
    BLOCK,
    BLOCK_ROWS,
    HEAD,
    HIGH,
    INFEASIBLE,
    ITERATIONS,
    KEEP,
    LAM,
    LOW,
    MASK,
    N_PAD,
    REORDER,
    STALE,
    STAMP,
    UNDECIDED,
    V0,
    M,
    N,
    V,
    Z,
    code_checksum,
    compiled,
    row_width,
    starts,
)
from dpbench.solvers.own.active_set.start import compute_unconstrained_values
from dpbench.solvers.own.compiled_workspace import CompiledWorkspace
from dpbench.solvers.own.proof import proves_infeasible


@compiled
def shift_multipliers(S: Matrix, width: int) -> None:
    """Shift the multipliers by one control increment for a warm start, or zero them."""
    n, n_pad, m = int(S[HEAD, N]) & MASK, int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M]) & MASK
    block, block_rows = int(S[HEAD, BLOCK]) & MASK, int(S[HEAD, BLOCK_ROWS]) & MASK
    if S[HEAD, STALE] > 0.0 or S[HEAD, KEEP] == 0.0:
        for i in range(width):
            S[LAM, i] = 0.0
        return
    for i in range(n - block):
        S[LAM, i] = S[LAM, i + block]
    for i in range(n_pad, n_pad + m - block_rows):
        S[LAM, i] = S[LAM, i + block_rows]


@compiled
def compute_all_row_values(S: Matrix, H: int, width: int) -> None:
    """Compute all row values C z from the multipliers and the unconstrained optimum."""
    for i in range(width):
        S[V, i] = S[V0, i]
    for r in range(width):
        a = S[LAM, r]
        if a != 0.0:
            for i in range(width):
                S[V, i] -= a * S[H + r, i]


@compiled
def sweep_multipliers(S: Matrix, H: int, width: int) -> tuple[float, float]:
    """Update each multiplier once; return the squared change and the largest row value change."""
    change, moved = 0.0, 0.0
    for i in range(width):
        S[BEFORE, i] = S[LAM, i]
        h = S[H + i, i]
        if h > 0.0:
            own, x = S[V, i] + h * S[LAM, i], 0.0
            if own > S[HIGH, i]:
                x = (own - S[HIGH, i]) / h
            elif own < S[LOW, i]:
                x = (own - S[LOW, i]) / h
            d = x - S[LAM, i]
            if d != 0.0:
                S[LAM, i] = x
                for k in range(width):
                    S[V, k] -= d * S[H + i, k]
                change += d * d
                moved = max(moved, abs(d) * h)
    return change, moved


@compiled
def has_impossible_zero_row(S: Matrix, H: int, width: int) -> bool:
    """Return whether a row of zeros has limits that exclude 0; store the proof as multipliers."""
    for i in range(width):
        if S[H + i, i] <= 0.0 and (S[LOW, i] > 0.0 or S[HIGH, i] < 0.0):
            for k in range(width):
                S[LAM, k] = 0.0
            S[LAM, i] = 1.0 if S[HIGH, i] < 0.0 else -1.0
            return True
    return False


@compiled
def run_sweeps(S: Matrix, max_iter: int, eps_change: float, eps_row: float) -> int:
    """Run Hildreth's method to convergence; return the number of sweeps or a failure code < 0."""
    n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
    K, _, H, _, _, _ = starts(n, width)
    shift_multipliers(S, width)
    size = compute_unconstrained_values(S, K)
    if size < 0.0:
        return int(size)
    if has_impossible_zero_row(S, H, width):
        return INFEASIBLE
    compute_all_row_values(S, H, width)
    ending = UNDECIDED
    for k in range(max_iter):
        change, moved = sweep_multipliers(S, H, width)
        S[HEAD, ITERATIONS] = k + 1
        if change < eps_change and moved <= eps_row:
            ending = k + 1
            break
    compute_all_row_values(S, H, width)
    for i in range(n):
        S[Z, i] = S[V, i]
    return ending


def _compile_entry_point(version: int) -> Callable[..., Any]:
    """Compile Hildreth's method as Python calls it, with a checksum of its code for the cache."""

    @njit("i8(f8[:, ::1], i8, f8, f8)", cache=True, fastmath=REORDER, error_model="numpy")
    def hildreth_step(S, max_iter, eps_change, eps_row):  # type: ignore[no-untyped-def] # Numba gives the types
        S[HEAD, STAMP] = version
        ending = run_sweeps(S, max_iter, eps_change, eps_row)
        S[HEAD, STALE] = 1.0 if ending < 0 and ending != UNDECIDED else 0.0
        return ending

    return hildreth_step


hildreth_step = _compile_entry_point(code_checksum(_compile_entry_point))
"""hildreth_step(S, max_iter, eps_change, eps_row): the sweeps it took to converge, or a negative
ending, `UNDECIDED` where it did not."""


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
    def from_options(cls, options: Mapping[str, object]) -> HildrethSettings:
        """Make stopping criteria from solver options; SettingsError unless all are positive."""
        for key, value in options.items():
            integer = key == "max_iter"
            if isinstance(value, bool) or not isinstance(value, int if integer else (int, float)):
                kind = "a whole number" if integer else "a number"
                raise SettingsError("settings of hildreth", key, repr(value), kind)
            if not value > 0:
                raise SettingsError("settings of hildreth", key, repr(value), "above 0")
        return cls(**options)  # type: ignore[arg-type] # checked above; keys by the caller


class HildrethWorkspace(CompiledWorkspace):
    """Hildreth's dual method as QP solver; `warm` keeps the multipliers between steps."""

    def __init__(
        self, solver: str, route: Route, policy: Policy, settings: HildrethSettings
    ) -> None:
        super().__init__(solver, route, policy)
        self._settings = settings

    def solve(self) -> None:
        """Run Hildreth's method until it converges or reaches the limit of sweeps."""
        if self._refusal or self._S is None:
            return self._refuse_to_solve()
        s = self._settings
        self._ending = ending = hildreth_step(self._S, s.max_iter, s.eps_change, s.eps_row)
        if ending == layout.UNDECIDED or ending == layout.INFEASIBLE:
            self._unusual = self._make_unconverged_solution()
        return None

    def _make_unconverged_solution(self) -> Solution:
        """Return PRIMAL_INFEASIBLE if growing multipliers prove it, else MAX_ITERATIONS."""
        qp, S = self._copy_current_problem(), self._S
        assert S is not None
        z, y, y_box = self._z.copy(), self._y.copy(), self._y_box.copy()
        dy, dy_box = y, y_box
        if self._ending == layout.UNDECIDED:
            n_pad = int(S[layout.HEAD, layout.N_PAD])
            dy = y - S[layout.BEFORE, n_pad : n_pad + qp.m]
            dy_box = y_box - S[layout.BEFORE, : qp.n]
        if proves_infeasible(qp, dy, dy_box):
            self.reset()
            detail = "y and y_box are a Farkas ray"
            none = np.full(qp.n, np.nan)
            return Solution(Status.PRIMAL_INFEASIBLE, none, dy, dy_box, detail=detail)
        sweeps = int(S[layout.HEAD, layout.ITERATIONS])
        return Solution(Status.MAX_ITERATIONS, z, y, y_box, sweeps)
