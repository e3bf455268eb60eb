"""Where a step starts: v₀, and the set of the step before, moved on and made dual feasible.

The multipliers come along with the set. What eq. 31 asks of it is another λ*, and where that has a
wrong sign λ goes towards it until the first multiplier reaches zero; that row is dropped, and λ*
is asked for again. To drop all rows that are wrong at once takes several times as many iterations,
for most of them come in again.

By hand, the point nearest (2, 1) and then the one nearest (1, −2) under z₁ ≤ 0 and z₂ − z₁ ≤ 0:

     what happens                                                      λ₀    λ₁₆   z
     the step before ends at the corner, both rows active              3     1     (0, 0)
     eq. 31 asks for −1 and −2 of them: λ₀ would be zero after ¾ of
       the way, λ₁₆ after 1/(1 + 2) = ⅓ of it. It is dropped there     5/3   0
     and eq. 31 asks for 1 of row 0 alone: no row has to come in       1     0     (0, −2)

>>> import numpy as np
>>> from dpbench.qp.program import QuadraticProgram
>>> from dpbench.solvers.own.active_set.constants import empty, fill
>>> from dpbench.solvers.own.active_set.kernel import solve_step
>>> from dpbench.solvers.own.active_set.layout import Z
>>> none, S = np.full(2, np.inf), empty(n=2, m=1)
>>> fill(S, QuadraticProgram(np.eye(2), [-2, -1], [[-1, 1]], [-9], [0], -none, [0, 9]), keep=True)
''
>>> solve_step(S), S[LAM, [0, 16]].round(12).tolist()
(2, [3.0, 1.0])
>>> S[Q, :2] = -1, 2
>>> solve_step(S), S[LAM, [0, 16]].round(12).tolist(), S[Z, :2].round(12).tolist()
(1, [1.0, 0.0], [0.0, -2.0])
"""

from __future__ import annotations

from math import inf, sqrt

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import (
    CLOSE,
    append,
    drop,
    is_wrong,
    solve_active,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    BEFORE,
    BLOCK,
    BLOCK_ROWS,
    CHECK,
    COUNT,
    CROSSED,
    HEAD,
    HIGH,
    INVERSE,
    ITERATIONS,
    KEEP,
    LAM,
    LENGTH,
    LOW,
    MASK,
    N_PAD,
    NOT_FINITE,
    SIDE,
    STALE,
    UNIT,
    V0,
    M,
    N,
    Q,
    R,
    compiled,
    width_of,
)
from dpbench.solvers.own.active_set.pricing import most_violated, values
from dpbench.solvers.own.active_set.spans import (
    ALL,
    product,
)


@compiled
def length(S: Matrix, row: int) -> float:
    """Length of a vector of row values in the norm of P⁻¹."""
    square = 0.0
    for i in range(width_of(S)):
        v = S[row, i] * S[UNIT, i]
        square += v * v
    return sqrt(square)


@compiled
def forget(S: Matrix) -> None:
    """Empty the active set, with all multipliers zero."""
    for i in range(width_of(S)):
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = S[HEAD, ASIDE] = S[HEAD, STALE] = 0.0


@compiled
def begin(S: Matrix, K: int) -> float:
    """v₀, and its length in the norm of P; a negative ending for data that have no answer."""
    n, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
    if S[HEAD, STALE] > 0.0 or S[HEAD, KEEP] == 0.0 or S[HEAD, ASIDE] > 0.0:
        forget(S)
    S[HEAD, ITERATIONS] = 0.0
    for i in range(width):
        S[V0, i] = 0.0
    product(S, V0, K, Q, n, ALL)
    size, bad = length(S, V0), 0
    for i in range(width):
        bad += not ((S[LOW, i] <= S[HIGH, i]) & (S[LOW, i] < inf) & (S[HIGH, i] > -inf))
    if not size < inf:
        return NOT_FINITE
    S[CHECK, LENGTH] = size
    return CROSSED if bad else size


@compiled
def multipliers(S: Matrix, L: int) -> int:
    """λ_W of the active set if none is wrong; how many are, or −1 if a limit is infinite."""
    w, wrong = int(S[HEAD, COUNT]) & MASK, 0
    if not solve_active(S, L, w):
        return -1
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        wrong += is_wrong(S, i, S[R, k])
    if wrong == 0:
        for k in range(w):
            S[LAM, int(S[ACTIVE, k]) & MASK] = S[R, k]
    return wrong


@compiled
def repair(S: Matrix, L: int) -> None:
    """Move λ to eq. 31, and drop the row whose multiplier is zero first, until there is none."""
    while True:
        w = int(S[HEAD, COUNT]) & MASK
        if not solve_active(S, L, w):
            return
        first, t = -1, 1.0
        for k in range(w):
            i, a = int(S[ACTIVE, k]) & MASK, S[R, k]
            if is_wrong(S, i, a):
                lam = abs(S[LAM, i])
                share = lam / (lam + abs(a))
                if first < 0 or share < t:
                    first, t = k, share
        if first < 0:
            for k in range(w):
                S[LAM, int(S[ACTIVE, k]) & MASK] = S[R, k]
            return
        for k in range(w):
            i = int(S[ACTIVE, k]) & MASK
            S[LAM, i] += t * (S[R, k] - S[LAM, i])
        drop(S, L, first, w)
        S[HEAD, ITERATIONS] += 1


@compiled
def take_in(S: Matrix, L: int, H: int, i: int, side: float, lam: float) -> None:
    """Row i into the set to start from, unless it is in, has no limit, or leans on the others."""
    w = int(S[HEAD, COUNT]) & MASK
    g = S[HIGH, i] if side > 0.0 else S[LOW, i]
    if S[SIDE, i] != 0.0 or abs(g) == inf or w == int(S[HEAD, N]):
        return
    d = S[H + i, i]
    for a in range(w):
        s = S[H + i, int(S[ACTIVE, a]) & MASK]
        for k in range(a):
            s -= S[L + a, k] * S[L + w, k]
        s *= S[INVERSE, a]
        S[L + w, a] = s
        d -= s * s
    if d > CLOSE * S[H + i, i]:
        append(S, L, w, i, side, d)
        S[LAM, i] = lam


@compiled
def take_out(S: Matrix) -> int:
    """Empty the set: rows and sides of it into BEFORE, λ into R; how many they are."""
    w = int(S[HEAD, COUNT]) & MASK
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[BEFORE, k], S[R, k] = (i + 1) * S[SIDE, i], S[LAM, i]
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = 0
    return w


@compiled
def retake(S: Matrix, L: int, H: int) -> None:
    """Factor the same set again, for what H has become."""
    for k in range(take_out(S)):
        side = 1.0 if S[BEFORE, k] > 0.0 else -1.0
        take_in(S, L, H, (int(abs(S[BEFORE, k])) - 1) & MASK, side, S[R, k])


@compiled
def shift(S: Matrix, L: int, H: int) -> None:
    """Shift the set by one move; the last move keeps what it had as well."""
    n, n_pad, m = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M])
    block, block_rows = int(S[HEAD, BLOCK]) & MASK, int(S[HEAD, BLOCK_ROWS]) & MASK
    for k in range(take_out(S)):
        side = 1.0 if S[BEFORE, k] > 0.0 else -1.0
        i = (int(abs(S[BEFORE, k])) - 1) & MASK
        first, end, by = (0, n, block) if i < n_pad else (n_pad, n_pad + m, block_rows)
        if i - first >= by:
            take_in(S, L, H, (i - by) & MASK, side, S[R, k])
        if i >= end - by:
            take_in(S, L, H, i, side, S[R, k])


@compiled
def take_in_equalities(S: Matrix, L: int, H: int) -> None:
    """Rows with equal limits are active whatever else is; those that lean on others stay out."""
    count, width = 0, width_of(S)
    for i in range(width):
        count += (S[LOW, i] == S[HIGH, i]) & (S[SIDE, i] == 0.0)
    for i in range(width if count else 0):
        if S[LOW, i] == S[HIGH, i]:
            take_in(S, L, H, i, 1.0, 0.0)


@compiled
def start(S: Matrix, L: int, H: int, noise: float) -> int:
    """Choose the set to start from and compute its v: the same as before if that will do.

    Returns a row it violates.
    """
    take_in_equalities(S, L, H)
    if S[HEAD, COUNT] > 0.0:
        wrong = multipliers(S, L)
        if wrong != 0:
            shift(S, L, H)
            take_in_equalities(S, L, H)
            repair(S, L)
    values(S, H)
    return most_violated(S, noise)
