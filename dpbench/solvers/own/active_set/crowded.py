"""Whether rounding decides which of the rows that an answer meets are active, and where it lies.

At the corner of a polygon more rows meet than there are dimensions. Which of them are active there
is decided by the rounding of their limits, but where they meet is not, if

- the rows of a basis B of those near their limits are at angles of more than `STEEP`;
- every other row near its limit is c_j = Σ a_k c_k over B, but for rounding, with shares a_k of
  more than `STEEP` or none at all, and of any two such rows with shares in one row the 2 by 2
  minors are so too: then any set of independent ones among all these rows is at such angles, as no
  three of them hang together;
- moved inwards from all limits by the same direction the point satisfies them, so that a feasible
  point is near however they were rounded: C_B d = −side leads inwards from c_j as well, if
  side_j Σ a_k side_k b_k > 0 for lengths b > 0, which asks for one share of the right sign.

A row that leaves others no room, as z₁ ≤ −1 leaves the bound z₁ ≥ −1 none, makes equalities of them
if that is so to the last bit, and counts no more. A thruster that has failed shrinks at its rate:
its plan has to make the largest steps there are.

By hand: z₁ ≤ 1, z₂ ≤ 1 and z₁ + z₂ ≤ 2 meet in (1, 1). With the first two for B, a = (1, 1): any
two of the three rows meet at that point, and d = (−1, −1) leads inwards from all of them. With
z₁ + z₂ ≥ 2 in place of the third side_j Σ a_k side_k b_k < 0, whatever b: (1, 1) is all that is
feasible, which is exact here; of z₁ + z₂/3 ≥ 4/3, which has been rounded, it may as well be that
nothing is. With z₁ + 1e-6 z₂ ≤ 1 + 1e-6 in its place, a = (1, 1e-6): it meets the first in a point
that rounding moves 1e6 times as far as a limit.

>>> import numpy as np
>>> from dpbench.qp.program import QuadraticProgram
>>> from dpbench.solvers.own.active_set.constants import empty, fill
>>> from dpbench.solvers.own.active_set.kernel import solve_step
>>> from dpbench.solvers.own.active_set.layout import DOUBTFUL
>>> def is_doubtful(row, low, high):
...     S, one = empty(n=2, m=1), np.ones(2)
...     meeting = np.eye(2), [-3, -3.5], [row], [low], [high], -9 * one, one
...     fill(S, QuadraticProgram(*meeting), keep=False)
...     return solve_step(S) == DOUBTFUL
>>> is_doubtful([1, 1], -9, 2), is_doubtful([1, 1e-6], -9, 1 + 1e-6)
(False, True)
>>> is_doubtful([1, 1], 2, 9), is_doubtful([1, 1 / 3], 4 / 3, 9)
(False, True)
"""

from __future__ import annotations

from math import floor, inf

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import DEPENDENT, append, direction
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    BEFORE,
    COUNT,
    HEAD,
    HIGH,
    INVERSE,
    LOW,
    MASK,
    N_PAD,
    SHARES,
    SIDE,
    STEP,
    UNIT,
    V0,
    VECTORS,
    N,
    R,
    V,
    compiled,
    width_of,
)

NEAR, STEEP = 1e-8, 1e-4
"""A row this share of its terms from its limit may be active; an active one that is no more than
this share of its length away from the others leans on them."""
NONE = 1e-9
"""A share of a combination that is less is rounding."""
MOST_EXTRA = 64
"""More inactive rows at their limits are left to the safeguards."""
MOST_DEPENDENT = VECTORS - SHARES
"""The same of those that are combinations of others and do not squeeze them."""
ROUNDS, INWARDS = 50, 0.05
"""Of a search for a direction inwards, and how far at least it has to lead."""
LARGEST_WHOLE = 2.0**40
"""Whole numbers below it are added without rounding."""


@compiled
def is_crowded(S: Matrix, L: int, H: int, J: int, size: float) -> bool:
    """Whether rounding may decide where the answer lies; `size` is its length in the norm of P."""
    near, w, width = 0, int(S[HEAD, COUNT]) & MASK, width_of(S)
    for i in range(width):
        u, v = S[UNIT, i], S[V, i]
        little = NEAR * (abs(v) * u + size)
        near += ((S[HIGH, i] - v) * u <= little) | ((v - S[LOW, i]) * u <= little)
    for k in range(w):
        if S[INVERSE, k] * STEEP > S[UNIT, int(S[ACTIVE, k]) & MASK]:
            return True
    if near == w:
        return False
    crowded = near > w + MOST_EXTRA or not corners_hold(S, L, H, J, size)
    # Rows that were only looked at leave the set again.
    for k in range(w, int(S[HEAD, COUNT]) & MASK):
        S[SIDE, int(S[ACTIVE, k]) & MASK] = 0.0
    S[HEAD, COUNT] = w
    return bool(crowded)


@compiled
def side_near(S: Matrix, i: int, size: float) -> float:
    """Return the side at which row i is near its limit, 0 for none, 2 for both."""
    u, v = S[UNIT, i], S[V, i]
    little = NEAR * (abs(v) * u + size)
    high, low = (S[HIGH, i] - v) * u <= little, (v - S[LOW, i]) * u <= little
    return 2.0 if high and low else 1.0 if high else -1.0 if low else 0.0


@compiled
def corners_hold(S: Matrix, L: int, H: int, J: int, size: float) -> bool:
    """Whether no rounding of limits moves the point where the rows near theirs meet, nor takes it.

    Those that are independent join the active ones first, for the others to be combinations.
    """
    n, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
    for k in range(int(S[HEAD, COUNT]) & MASK):
        i = int(S[ACTIVE, k]) & MASK
        if S[LOW, i] < S[HIGH, i] and side_near(S, i, size) == 2.0:
            return False
    rest = 0
    for i in range(width):
        side = side_near(S, i, size) if S[SIDE, i] == 0.0 else 0.0
        if side == 2.0 or (side != 0.0 and not S[H + i, i] > 0.0):
            return False
        if side != 0.0:
            w = int(S[HEAD, COUNT]) & MASK
            d = direction(S, L, H, J, i, n, w) if w < int(S[HEAD, N]) else 0.0
            if d > STEEP * STEEP * S[H + i, i]:
                for k in range(w):
                    S[L + w, k] = S[STEP, k]
                append(S, L, w, i, side, d)
            elif d > DEPENDENT * DEPENDENT * S[H + i, i]:
                return False
            else:
                S[BEFORE, rest] = i
                rest += 1
    w = int(S[HEAD, COUNT]) & MASK
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[V0, k] = inf if S[LOW, i] == S[HIGH, i] else 0.0
    rest = without_squeezed(S, L, H, J, rest, size)
    if rest > MOST_DEPENDENT:
        return False
    for r in range(rest):
        j = int(S[BEFORE, r]) & MASK
        direction(S, L, H, J, j, n, w)
        write_shares(S, r, j, side_near(S, j, size), w)
    return bool(exchanges_hold(S, rest, w) and leads_inwards(S, rest, w))


@compiled
def without_squeezed(S: Matrix, L: int, H: int, J: int, rest: int, size: float) -> int:
    """Take rows that squeeze others to their limits exactly from the list; how many are left."""
    n, w, left = int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, COUNT]) & MASK, rest
    A = J + width_of(S)
    for _ in range(rest):
        before, left = left, 0
        for r in range(before):
            i = int(S[BEFORE, r]) & MASK
            direction(S, L, H, J, i, n, w)
            if not squeezes(S, A, i, side_near(S, i, size), n, w):
                S[BEFORE, left] = i
                left += 1
        if left == before:
            break
    return left


@compiled
def squeezes(S: Matrix, A: int, j: int, side: float, n: int, w: int) -> bool:
    """Whether row j leaves those it is a combination of no room, to the last bit.

    Rows and limits of whole numbers are added without rounding.
    """
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        if S[V0, k] < inf and side * S[SIDE, i] * S[R, k] * S[UNIT, j] > NONE * S[UNIT, i]:
            return False
    for c in range(n + 1):
        total = entry(S, A, j, side, c, n)
        whole = total == floor(total) and abs(total) < LARGEST_WHOLE
        for k in range(w):
            share = floor(S[R, k] + 0.5)
            if abs(S[R, k] - share) > NONE:
                return False
            if share != 0.0:
                i = int(S[ACTIVE, k]) & MASK
                x = entry(S, A, i, S[SIDE, i], c, n)
                whole &= x == floor(x) and abs(share * x) < LARGEST_WHOLE
                total -= share * x
        if total != 0.0 or not whole:
            return False
    for k in range(w):
        if abs(S[R, k]) > NONE:
            S[V0, k] = inf
    return True


@compiled
def entry(S: Matrix, A: int, i: int, side: float, column: int, n: int) -> float:
    """Return an entry of row i of C; behind the last its limit."""
    if column == n:
        return float(S[HIGH, i] if side > 0.0 else S[LOW, i])
    if i < n:
        return 1.0 if i == column else 0.0
    return float(S[A + i - n, column])


@compiled
def write_shares(S: Matrix, r: int, j: int, side: float, w: int) -> None:
    """side_j a_k side_k of row j in row r of SHARES, in lengths of the rows; none of equalities."""
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        share = side * S[SIDE, i] * S[R, k] * S[UNIT, j] / S[UNIT, i]
        S[SHARES + r, k] = share if abs(share) > NONE and S[V0, k] < inf else 0.0


@compiled
def exchanges_hold(S: Matrix, rest: int, w: int) -> bool:
    """Whether each row may take the place of any it has a share of, and any two of any two."""
    for r in range(rest):
        partners = 0
        for k in range(w):
            if 0.0 < abs(S[SHARES + r, k]) < STEEP:
                return False
        for q in range(rest):
            together = False
            for k in range(w):
                together |= S[SHARES + r, k] * S[SHARES + q, k] != 0.0
            if q != r and together:
                partners += 1
                if partners > 1 or not pair_holds(S, SHARES + r, SHARES + q, w):
                    return False
    return True


@compiled
def pair_holds(S: Matrix, r: int, q: int, w: int) -> bool:
    """Whether no two columns of two rows of shares are nearly, but not quite, alike."""
    for k in range(w):
        if S[r, k] != 0.0 or S[q, k] != 0.0:
            for c in range(k):
                minor = abs(S[r, k] * S[q, c] - S[r, c] * S[q, k])
                if NONE < minor < STEEP:
                    return False
    return True


@compiled
def leads_inwards(S: Matrix, rest: int, w: int) -> bool:
    """Whether lengths b > 0 are found with Σ_k side_j a_k side_k b_k > 0 for every row j.

    The row that has least of it is added to b until all have some.
    """
    for k in range(w):
        S[V0, k] = 1.0
    for _ in range(ROUNDS):
        least, worst = inf, -1
        for r in range(rest):
            inwards = 0.0
            for k in range(w):
                inwards += S[SHARES + r, k] * S[V0, k]
            if inwards < least:
                least, worst = inwards, r
        if least > INWARDS:
            return True
        for k in range(w):
            S[V0, k] = max(S[V0, k] + S[SHARES + worst, k], INWARDS)
    return False
