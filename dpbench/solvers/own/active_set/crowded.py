"""Whether rounding decides which of the rows that an answer meets are active, and where it lies.

At the corner of a polygon more rows meet than there are dimensions. Which of them are active there
is decided by the rounding of their limits, but where they meet is not, if

- the rows of a basis B of those near their limits are at angles of more than `STEEP`;
- every other row near its limit is c_j = Σ a_k c_k over B, with shares a_k of more than `STEEP` or
  none at all: then any set of independent ones among them is at such angles too. What is shown so
  are exchanges of one row, and with them all, if no two combinations share a row;
- moved inwards from all limits by the same direction the point satisfies them, so that a feasible
  point is near however they were rounded: C_B d = −side leads inwards from c_j as well, if
  side_j Σ a_k side_k b_k > 0 for lengths b > 0, which asks for one share of the right sign.

By hand: z₁ ≤ 1, z₂ ≤ 1 and z₁ + z₂ ≤ 2 meet in (1, 1). With the first two for B, a = (1, 1): any
two of the three rows meet at that point, and d = (−1, −1) leads inwards from all of them. With
z₁ + z₂ ≥ 2 in place of the third side_j Σ a_k side_k b_k < 0, whatever b: (1, 1) is all that is
feasible, and nothing at all if 2 is rounded up. With z₁ + 1e-6 z₂ ≤ 1 + 1e-6 in its place, a =
(1, 1e-6): it meets the first in a point that rounding moves 1e6 times as far as a limit.

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
>>> is_doubtful([1, 1], -9, 2), is_doubtful([1, 1], 2, 9), is_doubtful([1, 1e-6], -9, 1 + 1e-6)
(False, True, True)
"""

from __future__ import annotations

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import append, direction
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
    SIDE,
    STEP,
    UNIT,
    V0,
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
MOST_EXTRA = 16
"""More inactive rows at their limits are left to the safeguards."""


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
    """The side at which row i is near its limit, 0 for none, 2 for both."""
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
            else:
                S[BEFORE, rest] = i
                rest += 1
    for k in range(int(S[HEAD, COUNT]) & MASK):
        S[V0, k] = 0.0
    for r in range(rest):
        i = int(S[BEFORE, r]) & MASK
        if not holds(S, L, H, J, i, side_near(S, i, size), n):
            return False
    return True


@compiled
def holds(S: Matrix, L: int, H: int, J: int, j: int, side: float, n: int) -> bool:
    """Whether row j may take the place of those it is a combination of, and be moved in with them.

    V0 counts the combinations that a row of the basis is part of.
    """
    w, inwards = int(S[HEAD, COUNT]) & MASK, False
    direction(S, L, H, J, j, n, w)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        share = S[R, k] * S[UNIT, j] / S[UNIT, i]
        if abs(share) > NONE:
            S[V0, k] += 1.0
            if abs(share) < STEEP or S[V0, k] > 1.0:
                return False
            inwards |= (side * S[SIDE, i] * share > 0.0) & (S[LOW, i] < S[HIGH, i])
    return bool(inwards)
