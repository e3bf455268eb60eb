"""How the active set of the compiled method moves: the rule of Goldfarb and Idnani, and a start.

From a dual feasible set the most violated row is brought in; rows whose multiplier reaches zero on
the way are dropped (see `qp/dual_active_set.py` for the rule and why it ends). What rounding does
not let it tell is answered `UNDECIDED`.
"""

from __future__ import annotations

from math import inf

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import append, backward, drop, forward
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    BEFORE,
    BLOCK,
    COUNT,
    HEAD,
    HIGH,
    INFEASIBLE,
    INVERSE,
    ITERATIONS,
    LAM,
    LIMIT,
    LOW,
    MASK,
    N_PAD,
    PUT_ASIDE,
    SIDE,
    STALE,
    STEP,
    UNDECIDED,
    UNIT,
    V0,
    E,
    M,
    N,
    R,
    V,
    X,
    compiled,
)

CLOSE = 1e-6
"""Below this share of its squared length a row's distance from the active ones is computed anew
from the rows themselves, because the factor has lost six digits of it."""
DEPENDENT, UNCLEAR = 1e-11, 1e-7
"""Below the first share of its length a row is a combination of the active ones; between the two
it cannot be told here."""
NO_PART = 1e-11
"""A row whose share in a combination is less has none: without a row to bring in, nothing but a
multiplier's way to zero ends a step, and on a share that is rounding that way has no end."""
CONTRADICTION = 1e-9
"""A violated dependent row is taken for a contradiction if violated by more than this share."""


@compiled
def distance(S: Matrix, L: int, J: int, j: int, n: int, w: int) -> float:
    """Squared distance of row j from the active ones, r and the factor's row corrected with it."""
    for again in range(2):
        for i in range(n):
            S[X, i] = S[J + j, i]
        for k in range(w):
            a, r = S[R, k], J + (int(S[ACTIVE, k]) & MASK)
            for i in range(n):
                S[X, i] -= a * S[r, i]
        if again == 0:
            for k in range(w):
                r, s = J + (int(S[ACTIVE, k]) & MASK), 0.0
                for i in range(n):
                    s += S[X, i] * S[r, i]
                S[E, k] = s
            forward(S, L, w, E)
            for k in range(w):
                S[STEP, k] += S[E, k]
            backward(S, L, w, E)
            for k in range(w):
                S[R, k] += S[E, k]
    d = 0.0
    for i in range(n):
        d += S[X, i] * S[X, i]
    return d


@compiled
def direction(S: Matrix, L: int, H: int, J: int, j: int, n: int, w: int) -> float:
    """r = H_WW⁻¹ H_Wj in R, the factor's new row in STEP; the squared distance of row j from W."""
    for k in range(w):
        S[STEP, k] = S[H + j, int(S[ACTIVE, k]) & MASK]
    forward(S, L, w, STEP)
    d = S[H + j, j]
    for k in range(w):
        S[R, k] = S[STEP, k]
        d -= S[STEP, k] * S[STEP, k]
    backward(S, L, w, R)
    if w > 0 and d < CLOSE * S[H + j, j]:
        return distance(S, L, J, j, n, w)
    return float(d)


@compiled
def ray(S: Matrix, j: int, side: float, w: int) -> int:
    """The multipliers become the proof that row j contradicts the active ones."""
    for i in range(S.shape[1]):
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
    for i in range(S.shape[1]):
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
    for i in range(S.shape[1]):
        if S[SIDE, i] == PUT_ASIDE:
            over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
            e, g = (over, S[HIGH, i]) if over >= under else (under, S[LOW, i])
            share = e * S[UNIT, i] / (CONTRADICTION * (abs(g) * S[UNIT, i] + size))
            if share > most:
                most, row = share, i
    if row >= 0:
        S[SIDE, row] = 0.0
        S[HEAD, ASIDE] -= 1
        for i in range(S.shape[1]):
            S[V0, i] += S[LAM, row] * S[H + row, i]
    return row


@compiled
def take_in(S: Matrix, L: int, H: int, i: int, side: float) -> None:
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


@compiled
def shift(S: Matrix, L: int, H: int) -> None:
    """The set moves on by one move; the last move keeps what it had as well."""
    n, n_pad, m = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M])
    block, w = int(S[HEAD, BLOCK]) & MASK, int(S[HEAD, COUNT]) & MASK
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[BEFORE, k] = (i + 1) * S[SIDE, i]
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = 0
    for k in range(w):
        side = 1.0 if S[BEFORE, k] > 0.0 else -1.0
        i = (int(abs(S[BEFORE, k])) - 1) & MASK
        first, end = (0, n) if i < n_pad else (n_pad, n_pad + m)
        if i - first >= block:
            take_in(S, L, H, (i - block) & MASK, side)
        if i >= end - block:
            take_in(S, L, H, i, side)


@compiled
def forget(S: Matrix) -> None:
    for i in range(S.shape[1]):
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = S[HEAD, ASIDE] = S[HEAD, STALE] = 0.0
