"""Which row to bring in next: v = C z of the active set (eq. 32), and the rows it violates.

    v = v₀ − H_:W λ_W,     v₀ = −C P⁻¹q

takes all of H_:W, more than everything else of an iteration. The method ends at the optimum
whichever violated row comes in, so v is computed in all rows once, those violated about as much as
the most violated one become candidates, and of these alone v is computed until none is violated.
"""

from __future__ import annotations

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import (
    limit_of,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    BEFORE,
    CANDIDATES,
    CHECK,
    COUNT,
    HEAD,
    HIGH,
    LAM,
    LOW,
    MASK,
    N_PAD,
    SIDE,
    UNIT,
    V0,
    V,
    Z,
    compiled,
    inlined,
    width_of,
)
from dpbench.solvers.own.active_set.spans import (
    ALL,
    NARROW,
    ROWS,
    add_row,
    product,
)

VIOLATED = 1e-13
"""A row counts as violated beyond this many roundings of the quantities it is computed from."""
SHARE, MOST_CANDIDATES = 0.3, 24
"""A candidate is violated by this share of the most violated row; at most as many candidates."""


@inlined
def add_active(S: Matrix, out: int, sign: float, H: int) -> None:
    """S[out] += sign · H_:W λ_W."""
    for k in range(int(S[HEAD, COUNT]) & MASK):
        i = int(S[ACTIVE, k]) & MASK
        add_row(S, out, sign * S[LAM, i], H + i, ALL)


@compiled
def values(S: Matrix, H: int) -> None:
    """Compute v of the active set (eq. 32)."""
    w = int(S[HEAD, COUNT]) & MASK
    for i in range(width_of(S)):
        S[V, i] = S[V0, i]
    add_active(S, V, -1.0, H)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[V, i] = limit_of(S, i)


@compiled
def row_values(S: Matrix, out: int, P: int, n: int) -> None:
    """S[out] = C Z, in the problem's own rows."""
    for i in range(n):
        S[out, i] = S[Z, i]
    for i in range(n, width_of(S)):
        S[out, i] = 0.0
    product(S, out, P, Z, n, ROWS)


@compiled
def evaluate(S: Matrix, P: int, H: int) -> None:
    """Compute v anew from Z, in the problem's own rows, and v₀ from v."""
    row_values(S, V, P, int(S[HEAD, N_PAD]) & MASK)
    for i in range(width_of(S)):
        S[V0, i] = S[V, i]
    add_active(S, V0, 1.0, H)


@compiled
def violation(S: Matrix, i: int, noise: float) -> float:
    """By how much row i is violated in the norm of P⁻¹; 0 if by no more than rounding."""
    over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
    e = over if over >= under else under
    if not e > 0.0:
        return 0.0
    e *= S[UNIT, i]
    g = S[HIGH, i] if over >= under else S[LOW, i]
    return float(e) if e > noise + VIOLATED * abs(g) * S[UNIT, i] else 0.0


@compiled
def most_violated(S: Matrix, noise: float) -> int:
    """Return the inactive row violated most in the norm of P⁻¹; −1 if there is none."""
    excess, width = 0.0, width_of(S)
    for i in range(width):
        over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
        excess += (over if over > 0.0 else 0.0) + (under if under > 0.0 else 0.0)
    if excess == 0.0:
        return -1
    most, worst = 0.0, -1
    for i in range(width):
        if S[SIDE, i] == 0.0:
            e = violation(S, i, noise)
            if e > most:
                most, worst = e, i
    return worst


@compiled
def list_candidates(S: Matrix, j: int, noise: float) -> None:
    """List the inactive rows violated by no less than `SHARE` of the most violated.

    That is row j.
    """
    least, count = SHARE * violation(S, j, noise), 0
    for i in range(width_of(S)):
        if count < MOST_CANDIDATES and i != j and S[SIDE, i] == 0.0:
            e = violation(S, i, noise)
            if e > 0.0 and e >= least:
                S[BEFORE, count] = i
                count += 1
    S[CHECK, CANDIDATES] = count


@compiled
def best_candidate(S: Matrix, H: int, noise: float) -> int:
    """Return the candidate violated most now, −1 if there is none.

    Those not violated leave the list.
    """
    count, w = int(S[CHECK, CANDIDATES]) & MASK, int(S[HEAD, COUNT]) & MASK
    most, worst, left = 0.0, -1, 0
    for c in range(count):
        i = int(S[BEFORE, c]) & MASK
        if S[SIDE, i] != 0.0:
            continue
        v = S[V0, i]
        for k in range(w):
            r = int(S[ACTIVE, k]) & MASK
            v -= S[H + i, r] * S[LAM, r]
        S[V, i] = v
        e = violation(S, i, noise)
        if e > 0.0:
            S[BEFORE, left] = i
            left += 1
        if e > most:
            most, worst = e, i
    S[CHECK, CANDIDATES] = left
    return worst


@inlined
def next_row(S: Matrix, H: int, noise: float) -> int:
    """Return the row to add: the most violated candidate, or of all rows where none is left."""
    many = width_of(S) > NARROW
    j = best_candidate(S, H, noise) if many else -1
    if j < 0:
        values(S, H)
        j = most_violated(S, noise)
        if many and j >= 0:
            list_candidates(S, j, noise)
    return j
