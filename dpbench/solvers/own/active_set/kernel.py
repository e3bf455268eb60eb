"""The paper's active-set method (eq. 30-32) compiled: one call per step.

The set of the step before is tried as it is. If it is not optimal it is moved on by one move with
its multipliers, and these are moved to what eq. 31 asks for; a row whose multiplier reaches zero on
the way is dropped. From that dual feasible set the rule of Goldfarb and Idnani goes on: the most
violated row is brought in, and rows whose multiplier reaches zero on the way are dropped
(`qp/dual_active_set.py` says why that ends for any such start). What rounding does not let it tell
is answered `UNDECIDED`. The answer is then refined in the problem's own data,

    P δz + C_Wᵀ δλ = −(P z + q + Cᵀλ),   C_W δz = g − C_W z,

until a correction is rounding, or the next one would be. It is checked against every row again if
it is not at once; in full (`check`) where rounding of large multipliers or of a long plan may show;
and where more rows meet than are active, whether rounding moves the point (`crowded`). `layout`
shows the array S that all of it works on, and what its indices mean.

An example to follow by hand: the point nearest (3, 3) under z₁ ≤ 1, z₂ ≤ 1 and z₁ + z₂ ≤ 2.5, that
is P = I and q = (−3, −3). Bounds are rows 0 and 1 of C, the row of A is row 16 as n is padded to
16. H holds the products of the rows: 1 for a bound with itself, 1 for a bound with the row of A, 2
for that row with itself.

     what happens                                          λ₀    λ₁    λ₁₆    z
     start: q alone; violated, in lengths of the rows,                        (3, 3)
       are the bounds by 2 each, row 16 by 3.5/√2 = 2.47
     1 row 16 comes in: λ₁₆ = 3.5/H = 3.5/2                            1.75   (1.25, 1.25)
     2 row 0, the first of two violated by 0.25: of it
       ½ lies along row 16, so that 1 − ½·1 = ½ of its
       length² is its own; λ₀ = 0.25/½, λ₁₆ −= ½·λ₀        0.5         1.5    (1, 1.5)
     3 row 1, violated by 0.5, is row 16 less row 0: no
       step along z; as λ₁ grows, λ₁₆ falls and λ₀ grows
       alike. At 1.5 λ₁₆ is zero and row 16 is dropped     2.0   (1.5) 0      (1, 1.5)
     4 row 1 at last is free of row 0: λ₁ += 0.5/1         2.0   2.0          (1, 1)

The slope there is z − (3, 3) + (λ₀, λ₁) = 0 with both λ ≥ 0: the optimum. Allowed fewer iterations,
the method stops where the table does:

>>> import numpy as np
>>> from dpbench.qp.program import QuadraticProgram
>>> from dpbench.solvers.own.active_set.constants import empty, fill
>>> from dpbench.solvers.own.active_set.layout import ACTIVE, LAM, LIMIT, Z
>>> upper = np.ones(2)
>>> nearest = np.eye(2), [-3, -3], [[1, 1]], [-10], [2.5], -10 * upper, upper
>>> S = empty(n=2, m=1)
>>> fill(S, QuadraticProgram(*nearest), keep=False)
''
>>> def multipliers_after(iterations):
...     S[HEAD, LIMIT] = iterations
...     solve_step(S)
...     active = S[ACTIVE, : int(S[HEAD, COUNT])].astype(int)
...     return {int(i): round(float(S[LAM, i]), 12) for i in active}
>>> multipliers_after(1)
{16: 1.75}
>>> multipliers_after(2)
{16: 1.5, 0: 0.5}
>>> multipliers_after(3)
{0: 2.0}
>>> multipliers_after(4)
{0: 2.0, 1: 2.0}
>>> solve_step(S), S[Z, :2].round(12).tolist()
(4, [1.0, 1.0])
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt
from typing import Any

from numba import njit

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.check import excess, is_near, largest
from dpbench.solvers.own.active_set.crowded import is_crowded
from dpbench.solvers.own.active_set.factor import (
    CLOSE,
    VIOLATED,
    append,
    direction,
    drop,
    evaluate,
    most_violated,
    multipliers,
    refine,
    repair,
    row_values,
    settle_signs,
    values,
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
    DOUBTFUL,
    HEAD,
    HIGH,
    INFEASIBLE,
    INVERSE,
    ITERATIONS,
    KEEP,
    LAM,
    LARGEST,
    LENGTH,
    LIMIT,
    LONGEST,
    LOW,
    MASK,
    MOST,
    N_PAD,
    NOT_FINITE,
    PUT_ASIDE,
    REORDER,
    SIDE,
    STALE,
    STAMP,
    STEEPEST,
    STEP,
    UNDECIDED,
    UNIT,
    V0,
    WORST,
    M,
    N,
    Q,
    R,
    V,
    compiled,
    stamp,
    starts,
    width_of,
)
from dpbench.solvers.own.active_set.spans import ALL, GROUP, mark, product

DEPENDENT, UNCLEAR = 1e-11, 1e-7
"""Below the first share of its length a row is a combination of the active ones; between the two
it cannot be told here."""
NO_PART = 1e-11
"""A row whose share in a combination is less has none: without a row to bring in, nothing but a
multiplier's way to zero ends a step, and on a share that is rounding that way has no end."""
CONTRADICTION = 1e-9
"""A violated dependent row is taken for a contradiction if violated by more than this share."""


@compiled
def ray(S: Matrix, j: int, side: float, w: int) -> int:
    """The multipliers become the proof that row j contradicts the active ones."""
    for i in range(width_of(S)):
        S[LAM, i] = 0.0
    for k in range(w):
        S[LAM, int(S[ACTIVE, k]) & MASK] = -side * S[R, k]
    S[LAM, j] = side
    return INFEASIBLE


@compiled
def put_aside(S: Matrix, H: int, j: int, lam: float) -> int:
    """Row j is the active ones written twice: what multiplier it has gathered stays in v₀."""
    S[SIDE, j], S[LAM, j] = PUT_ASIDE, lam
    S[HEAD, ASIDE] += 1
    for i in range(width_of(S)):
        S[V0, i] -= lam * S[H + j, i]
    return 0


@compiled
def first_to_block(S: Matrix, j: int, side: float, w: int, dependent: bool) -> tuple[int, float]:
    """Position in W and step length at which a multiplier reaches zero first; (−1, inf) if none."""
    blocking, t_dual = -1, inf
    for k in range(w):
        i, a = int(S[ACTIVE, k]) & MASK, side * S[R, k]
        nothing = dependent and abs(a) * S[UNIT, j] < NO_PART * S[UNIT, i]
        if a * S[SIDE, i] > 0.0 and S[LOW, i] < S[HIGH, i] and not nothing:
            t = max(S[LAM, i] / a, 0.0)
            if t < t_dual:
                blocking, t_dual = k, t
    return blocking, t_dual


@compiled
def bring_in(S: Matrix, L: int, H: int, J: int, j: int, size: float) -> int:
    """Raise the multiplier of row j until the row is active; rows that block are dropped.

    A dependent row that nothing blocks is a contradiction, or the active rows written twice; with
    an infinite `size` it is always the latter.
    """
    n = int(S[HEAD, N]) & MASK
    side = 1.0 if S[V, j] > S[HIGH, j] else -1.0
    g = S[HIGH, j] if side > 0.0 else S[LOW, j]
    gap, lam = side * (S[V, j] - g), S[LAM, j]
    while S[HEAD, ITERATIONS] < S[HEAD, LIMIT]:
        S[HEAD, ITERATIONS] += 1
        w = int(S[HEAD, COUNT]) & MASK
        d = direction(S, L, H, J, j, int(S[HEAD, N_PAD]) & MASK, w)
        dependent = w == n or d <= DEPENDENT * DEPENDENT * S[H + j, j]
        if not dependent and d < UNCLEAR * UNCLEAR * S[H + j, j]:
            return UNDECIDED
        blocking, t_dual = first_to_block(S, j, side, w, dependent)
        if dependent and blocking < 0:
            if gap * S[UNIT, j] > CONTRADICTION * (abs(g) * S[UNIT, j] + size):
                return ray(S, j, side, w)
            return put_aside(S, H, j, lam)
        t_primal = inf if dependent else gap / d
        t = min(t_primal, t_dual)
        for k in range(w):
            S[LAM, int(S[ACTIVE, k]) & MASK] -= t * side * S[R, k]
        lam += t * side
        if t_primal <= t_dual:
            for k in range(w):
                S[L + w, k] = S[STEP, k]
            S[LAM, j] = lam
            append(S, L, w, j, side, d)
            return 0
        if not dependent:
            gap -= t * d
        drop(S, L, blocking, w)
    return UNDECIDED


@compiled
def take_up(S: Matrix, H: int, size: float) -> int:
    """The row put aside that is violated most, if by more than rounding, as any other row again."""
    most, row = 1.0, -1
    for i in range(width_of(S)):
        if S[SIDE, i] == PUT_ASIDE:
            over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
            e, g = (over, S[HIGH, i]) if over >= under else (under, S[LOW, i])
            share = e * S[UNIT, i] / (CONTRADICTION * (abs(g) * S[UNIT, i] + size))
            if share > most:
                most, row = share, i
    if row >= 0:
        S[SIDE, row] = 0.0
        S[HEAD, ASIDE] -= 1
        for i in range(width_of(S)):
            S[V0, i] += S[LAM, row] * S[H + row, i]
    return row


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
def shift(S: Matrix, L: int, H: int) -> None:
    """The set moves on by one move; the last move keeps what it had as well."""
    n, n_pad, m = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M])
    block, block_rows = int(S[HEAD, BLOCK]) & MASK, int(S[HEAD, BLOCK_ROWS]) & MASK
    w = int(S[HEAD, COUNT]) & MASK
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[BEFORE, k], S[R, k] = (i + 1) * S[SIDE, i], S[LAM, i]
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = 0
    for k in range(w):
        side = 1.0 if S[BEFORE, k] > 0.0 else -1.0
        i = (int(abs(S[BEFORE, k])) - 1) & MASK
        first, end, by = (0, n, block) if i < n_pad else (n_pad, n_pad + m, block_rows)
        if i - first >= by:
            take_in(S, L, H, (i - by) & MASK, side, S[R, k])
        if i >= end - by:
            take_in(S, L, H, i, side, S[R, k])


@compiled
def forget(S: Matrix) -> None:
    for i in range(width_of(S)):
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = S[HEAD, ASIDE] = S[HEAD, STALE] = 0.0


PASSES = 20
"""Rounds of refinement after which it has not settled."""
SETTLED = 1e-12
"""A correction of no more than this share leaves nothing to correct: each is a small part of the
one before."""
NO_ERROR, ROUNDING = 1e-9, 1e-14
"""Allowed in a row, and in the gradient of 1 + ‖q‖; what rounding leaves of a plan's length."""
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
    product(S, V0, K, Q, n, ALL)
    size, bad = length(S, V0, width), 0
    for i in range(width):
        bad += not ((S[LOW, i] <= S[HIGH, i]) & (S[LOW, i] < inf) & (S[HIGH, i] > -inf))
    if not size < inf:
        return NOT_FINITE
    S[CHECK, LENGTH] = size
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
def bring_all_in(S: Matrix, L: int, H: int, J: int, j: int, coarse: float, size: float) -> int:
    """Bring in row j and then the most violated one until there is none; 0, or an ending."""
    width = width_of(S)
    while j >= 0:
        ending = bring_in(S, L, H, J, j, size)
        if ending != 0:
            return ending
        values(S, H, width)
        j = most_violated(S, width, coarse)
    return 0


@compiled
def look_again(S: Matrix, P: int, L: int, H: int, noise: float, size: float, dropped: int) -> int:
    """A row that the refined point violates, or one put aside that it violates; −1 for none."""
    width = width_of(S)
    evaluate(S, P, H, width)
    if dropped > 0:
        repair(S, L)
        values(S, H, width)
    j = most_violated(S, width, noise)
    return take_up(S, H, size) if j < 0 and S[HEAD, ASIDE] > 0.0 else j


@compiled
def is_clear(S: Matrix, size: float, correction: float) -> bool:
    """Whether what is left after a settled correction is no error of any row or of the gradient."""
    cost = max(1.0, largest(S, Q, int(S[HEAD, N_PAD]) & MASK))
    error = max(correction, ROUNDING * size)
    small = error * S[CHECK, LONGEST] <= NO_ERROR and error * S[CHECK, STEEPEST] <= NO_ERROR * cost
    return bool(small and S[CHECK, LARGEST] <= S[CHECK, MOST] and S[HEAD, ASIDE] == 0.0)


@compiled
def solved(S: Matrix, P: int, H: int, size: float, clear: bool) -> int:
    """The number of iterations; `DOUBTFUL` where rounding may decide where the optimum is."""
    n, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
    _, _, _, J, _, L = starts(n, width)
    if is_crowded(S, L, H, J, size):
        return DOUBTFUL
    if not clear and (S[HEAD, ASIDE] > 0.0 or not is_near(S, P, H, n, width)):
        return DOUBTFUL
    return int(S[HEAD, ITERATIONS])


@compiled
def solve(S: Matrix) -> int:
    n, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
    K, P, H, J, A, L = starts(n, width)
    size = begin(S, K, width)
    if size < 0.0:
        return int(size)
    coarse, first, before = VIOLATED * size, size * size, size * size
    j = start(S, L, H, width, coarse)
    # Whether rows contradict each other is decided on refined values only.
    size = inf
    for _ in range(PASSES):
        ending = bring_all_in(S, L, H, J, j, coarse, size)
        if ending != 0:
            return ending
        correction = refine(S, K, P, H, A, L)
        rounding = sqrt(max(correction, 0.0))
        dropped = settle_signs(S, L, max(coarse, rounding))
        size = length(S, V, width)
        fine = VIOLATED * size
        # What the next correction would be: as much smaller as this one is.
        following = correction * min(1.0, correction / before)
        settled = dropped == 0 and following <= SETTLED * SETTLED * size * size
        clear = settled and is_clear(S, size, rounding)
        if clear and coarse > NEAR * fine:
            row_values(S, V, P, n, width)
            clear = most_violated(S, width, fine) < 0
        if clear:
            return solved(S, P, H, size, clear)
        j = look_again(S, P, L, H, max(fine, rounding), size, dropped)
        # No longer falling: the correction is the rounding of this problem.
        falling = correction <= 0.25 * before
        if j < 0 and (settled or (dropped == 0 and not falling)):
            if clear or excess(S, P, n, width) <= 1.0:
                return solved(S, P, H, size, clear)
            # What is left to do if it does not fall: a row that `VIOLATED` has let pass.
            j = -1 if falling else int(S[CHECK, WORST])
            if j < 0 and not falling:
                return UNDECIDED
        before = correction if j < 0 else first
    return UNDECIDED


def _entry_points(version: int) -> tuple[Callable[..., Any], ...]:
    """What Python calls: compiled for these types only, and kept on disk."""

    @njit("i8(f8[:, ::1])", cache=True, fastmath=REORDER, error_model="numpy")
    def solve_step(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        ending = solve(S)
        S[HEAD, STALE] = 1.0 if ending < 0 and ending != DOUBTFUL else 0.0
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

    @njit("f8(f8[:, ::1])", cache=True, fastmath=REORDER, error_model="numpy")
    def excess_of(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
        return excess(S, starts(n, width)[1], n, width)

    @njit("void(f8[:, ::1])", cache=True, error_model="numpy")
    def mark_spans(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
        K, P, H, J, _, _ = starts(n, width)
        mark(S, K, P, GROUP, n)
        mark(S, P, H, GROUP, n)
        mark(S, H, J, 1, n)

    # Without Numba's dispatcher, which takes 0.1 µs a call to find the type of S again.
    return solve_step.get_overload(solve_step.signatures[0]), take_over, excess_of, mark_spans


solve_step, take_over, excess_of, mark_spans = _entry_points(stamp())
"""solve_step(S): solve the QP in S; the number of iterations, or a negative ending.
take_over(S, q, l, u): copy the vectors into S, or False where a length does not fit; TypeError for
anything but contiguous float64 vectors that may be written to.
mark_spans(S): write where the rows of K, [P Aᵀ] and H are not zero; after every change of them.
excess_of(S): how many times what is allowed z and λ in S miss the optimality conditions by."""
