"""The paper's active-set method (eq. 30-32) compiled: one call per step.

The set of the step before is tried as it is. If it is not optimal it is moved on by one move, its
wrong multipliers are dropped until the rest is dual feasible, and the rule of Goldfarb and Idnani
goes on from there, which ends for any such start. The answer is then refined in the problem's own
data,

    P δz + C_Wᵀ δλ = −(P z + q + Cᵀλ),   C_W δz = g − C_W z,

until the correction is rounding, and is checked against every row again if it is not at once.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt
from typing import Any

from numba import njit

from dpbench.qp.program import Matrix
from dpbench.solvers.active_set_factor import (
    VIOLATED,
    most_violated,
    multipliers,
    product,
    repair,
    values,
)
from dpbench.solvers.active_set_layout import (
    ASIDE,
    COUNT,
    CROSSED,
    HEAD,
    HIGH,
    ITERATIONS,
    KEEP,
    LOW,
    MASK,
    N_PAD,
    NOT_FINITE,
    REORDER,
    STALE,
    STAMP,
    UNDECIDED,
    UNIT,
    V0,
    VECTORS,
    M,
    N,
    Q,
    V,
    compiled,
    stamp,
)
from dpbench.solvers.active_set_moves import bring_in, forget, shift, take_up
from dpbench.solvers.active_set_refine import evaluate, refine, settle_signs

PASSES = 20
"""Rounds of refinement after which it has not settled."""
SETTLED = 1e-12
"""A correction of no more than this share leaves nothing to correct: each is a small part of the
one before."""
NEAR = 10.0
"""How much longer v₀ may be than v before v, their difference, is computed anew."""


@compiled
def length(S: Matrix, row: int, width: int) -> float:
    """Length of a vector of row values in the norm of P⁻¹."""
    square = 0.0
    for i in range(width):
        v = S[row, i] * S[UNIT, i]
        square += v * v
    return sqrt(square)


@compiled
def begin(S: Matrix, K: int, width: int) -> float:
    """v₀, and its length in the norm of P; a negative ending for data that have no answer."""
    n = int(S[HEAD, N_PAD]) & MASK
    if S[HEAD, STALE] > 0.0 or S[HEAD, KEEP] == 0.0 or S[HEAD, ASIDE] > 0.0:
        forget(S)
    S[HEAD, ITERATIONS] = 0.0
    for i in range(width):
        S[V0, i] = 0.0
    product(S, V0, K, Q, n, 0, width)
    size, bad = length(S, V0, width), 0
    for i in range(width):
        bad += not ((S[LOW, i] <= S[HIGH, i]) & (S[LOW, i] < inf) & (S[HIGH, i] > -inf))
    if not size < inf:
        return NOT_FINITE
    return CROSSED if bad else size


@compiled
def start(S: Matrix, L: int, H: int, width: int, noise: float) -> int:
    """The set to start from and its v: the same as before if that will do; a row it violates."""
    if S[HEAD, COUNT] > 0.0:
        wrong = multipliers(S, L)
        if wrong != 0:
            shift(S, L, H)
            repair(S, L)
    values(S, H, width)
    return most_violated(S, width, noise)


@compiled
def solve(S: Matrix) -> int:
    n, width = int(S[HEAD, N_PAD]) & MASK, S.shape[1] & MASK
    K = VECTORS
    P, H = K + n, K + 2 * n
    J = H + width
    A = J + width
    L = A + width - n
    size = begin(S, K, width)
    if size < 0.0:
        return int(size)
    coarse, before = VIOLATED * size, inf
    j = start(S, L, H, width, coarse)
    # Whether rows contradict each other is decided on refined values only.
    size = inf
    for _ in range(PASSES):
        while j >= 0:
            ending = bring_in(S, L, H, J, j, size)
            if ending != 0:
                return ending
            values(S, H, width)
            j = most_violated(S, width, coarse)
        correction = refine(S, K, P, H, A, L)
        dropped = settle_signs(S, L, max(coarse, sqrt(max(correction, 0.0))))
        size = length(S, V, width)
        fine = VIOLATED * size
        settled = dropped == 0 and correction <= SETTLED * SETTLED * size * size
        if settled and coarse <= NEAR * fine and S[HEAD, ASIDE] == 0.0:
            return int(S[HEAD, ITERATIONS])
        evaluate(S, P, H, width)
        if dropped > 0:
            repair(S, L)
            values(S, H, width)
        j = most_violated(S, width, max(fine, sqrt(max(correction, 0.0))))
        if j < 0 and S[HEAD, ASIDE] > 0.0:
            j = take_up(S, H, size)
        # No longer falling: the correction is the rounding of this problem.
        if j < 0 and (settled or (dropped == 0 and correction > 0.25 * before)):
            return int(S[HEAD, ITERATIONS])
        before = correction
    return UNDECIDED


def _entry_points(version: int) -> tuple[Callable[..., Any], ...]:
    """What Python calls: compiled for these types only, and kept on disk."""

    @njit("i8(f8[:, ::1])", cache=True, fastmath=REORDER, error_model="numpy")
    def solve_step(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        ending = solve(S)
        S[HEAD, STALE] = 1.0 if ending < 0 else 0.0
        return ending

    @njit("b1(f8[:, ::1], f8[::1], f8[::1], f8[::1])", cache=True)
    def take_over(S, q, low, high):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, n_pad, m = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M])
        if q.shape[0] != n or low.shape[0] != m or high.shape[0] != m:
            return False
        for i in range(n):
            S[Q, i] = q[i]
        for i in range(m):
            S[LOW, n_pad + i], S[HIGH, n_pad + i] = low[i], high[i]
        return True

    # Without Numba's dispatcher, which takes 0.1 µs a call to find the type of S again.
    return solve_step.get_overload(solve_step.signatures[0]), take_over


solve_step, take_over = _entry_points(stamp())
"""solve_step(S): solve the QP in S; the number of iterations, or a negative ending.
take_over(S, q, l, u): copy the vectors into S, or False where a length does not fit; TypeError for
anything but contiguous float64 vectors that may be written to."""
