"""Hildreth's dual coordinate ascent, compiled, on the array of the active-set method.

With v = C z and H = C P⁻¹ Cᵀ as there, the multipliers are visited one after the other, and each is
set to the value that is best while the others stay:

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
>>> from dpbench.solvers.own.active_set.constants import empty, fill
>>> none = np.full(2, np.inf)
>>> limits = [-np.inf], [2], -none, [0.5, np.inf]
>>> S = empty(n=2, m=1)
>>> fill(S, QuadraticProgram(np.eye(2), [-2, -2], [[1, 1]], *limits), keep=False)
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

from collections.abc import Callable
from typing import Any

from numba import njit

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.kernel import begin
from dpbench.solvers.own.active_set.layout import (
    BEFORE,
    BLOCK,
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
    compiled,
    stamp,
    starts,
)


@compiled
def carry_over(S: Matrix, width: int) -> None:
    """The multipliers move on by one move, those of the last move stay; or all become zero."""
    n, n_pad, m = int(S[HEAD, N]) & MASK, int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M]) & MASK
    block = int(S[HEAD, BLOCK]) & MASK
    if S[HEAD, STALE] > 0.0 or S[HEAD, KEEP] == 0.0:
        for i in range(width):
            S[LAM, i] = 0.0
        return
    for i in range(n - block):
        S[LAM, i] = S[LAM, i + block]
    for i in range(n_pad, n_pad + m - block):
        S[LAM, i] = S[LAM, i + block]


@compiled
def evaluate_all(S: Matrix, H: int, width: int) -> None:
    """v = v₀ − H λ, from nothing."""
    for i in range(width):
        S[V, i] = S[V0, i]
    for r in range(width):
        a = S[LAM, r]
        if a != 0.0:
            for i in range(width):
                S[V, i] -= a * S[H + r, i]


@compiled
def sweep(S: Matrix, H: int, width: int) -> tuple[float, float]:
    """Visit every multiplier once; ‖Δλ‖² and the most a row was moved by."""
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
def impossible(S: Matrix, H: int, width: int) -> bool:
    """Whether a row of zeros is asked to be something else; it becomes the proof."""
    for i in range(width):
        if S[H + i, i] <= 0.0 and (S[LOW, i] > 0.0 or S[HIGH, i] < 0.0):
            for k in range(width):
                S[LAM, k] = 0.0
            S[LAM, i] = 1.0 if S[HIGH, i] < 0.0 else -1.0
            return True
    return False


@compiled
def ascend(S: Matrix, max_iter: int, eps_change: float, eps_row: float) -> int:
    n, width = int(S[HEAD, N_PAD]) & MASK, S.shape[1] & MASK
    K, _, H, _, _, _ = starts(n, width)
    carry_over(S, width)
    size = begin(S, K, width)
    if size < 0.0:
        return int(size)
    if impossible(S, H, width):
        return INFEASIBLE
    evaluate_all(S, H, width)
    ending = UNDECIDED
    for k in range(max_iter):
        change, moved = sweep(S, H, width)
        S[HEAD, ITERATIONS] = k + 1
        if change < eps_change and moved <= eps_row:
            ending = k + 1
            break
    evaluate_all(S, H, width)
    for i in range(n):
        S[Z, i] = S[V, i]
    return ending


def _entry_point(version: int) -> Callable[..., Any]:
    @njit("i8(f8[:, ::1], i8, f8, f8)", cache=True, fastmath=REORDER, error_model="numpy")
    def hildreth_step(S, max_iter, eps_change, eps_row):  # type: ignore[no-untyped-def] # numba
        S[HEAD, STAMP] = version
        ending = ascend(S, max_iter, eps_change, eps_row)
        S[HEAD, STALE] = 1.0 if ending < 0 and ending != UNDECIDED else 0.0
        return ending

    return hildreth_step


hildreth_step = _entry_point(stamp())
"""hildreth_step(S, max_iter, eps_change, eps_row): the sweeps it took to converge, or a negative
ending, `UNDECIDED` where it did not."""
