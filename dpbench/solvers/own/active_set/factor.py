"""The Cholesky factor L of H_WW, H = C P⁻¹ Cᵀ (the paper's M E⁻¹ Mᵀ), and what is solved with it.

L is kept by rows: a row brought in is a row appended, a row dropped is a chain of plane rotations
(G. H. Golub and C. F. Van Loan, Matrix Computations, section 6.5). With v₀ = −C P⁻¹q and the limits
g of the active set W

    λ_W = H_WW⁻¹ (v₀_W − g)                                                            (eq. 31)
"""

from __future__ import annotations

from math import inf, sqrt

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    COUNT,
    HEAD,
    HIGH,
    INVERSE,
    LAM,
    LOW,
    MASK,
    SIDE,
    STEP,
    V0,
    E,
    R,
    X,
    compiled,
)

DEPENDENT = 1e-11
"""A row no more than this share of its length away from the active ones combines from them."""
CLOSE = 1e-6
"""Below this share of its squared length a row's distance from the active ones is computed anew
from the rows themselves, because the factor has lost six digits of it."""


@compiled
def forward(S: Matrix, L: int, w: int, b: int) -> None:
    """Solve L x = b in place, for row b of S."""
    for i in range(w):
        s = S[b, i]
        for k in range(i):
            s -= S[L + i, k] * S[b, k]
        S[b, i] = s * S[INVERSE, i]


@compiled
def backward(S: Matrix, L: int, w: int, b: int) -> None:
    """Solve Lᵀ x = b in place, for row b of S."""
    for i in range(w - 1, -1, -1):
        x = S[b, i] * S[INVERSE, i]
        S[b, i] = x
        for k in range(i):
            S[b, k] -= S[L + i, k] * x


@compiled
def limit_of(S: Matrix, i: int) -> float:
    """Return the limit that row i is held at."""
    g: float = S[HIGH, i] if S[SIDE, i] > 0.0 else S[LOW, i]
    return g


@compiled
def is_wrong(S: Matrix, i: int, lam: float) -> bool:
    """Whether λ is a multiplier of the other limit than the one that row i is held at."""
    return bool((lam * S[SIDE, i] < 0.0) & (S[LOW, i] < S[HIGH, i]))


@compiled
def append(S: Matrix, L: int, w: int, i: int, side: float, pivot: float) -> int:
    """Make row i active; its row of the factor is in place but for the diagonal."""
    d = sqrt(pivot)
    S[L + w, w], S[INVERSE, w] = d, 1.0 / d
    S[ACTIVE, w], S[SIDE, i] = i, side
    S[HEAD, COUNT] = w + 1
    return w + 1


@compiled
def drop(S: Matrix, L: int, k: int, w: int) -> None:
    """Make the k-th active row inactive: rotate what its column leaves above the diagonal away."""
    i = int(S[ACTIVE, k]) & MASK
    S[SIDE, i] = S[LAM, i] = 0.0
    for r in range(k, w - 1):
        S[ACTIVE, r] = S[ACTIVE, r + 1]
        for c in range(k):
            S[L + r, c] = S[L + r + 1, c]
        x = S[L + r + 1, k]
        for c in range(k, r):
            y = S[L + r + 1, c + 1]
            S[L + r, c] = S[X, c] * x + S[E, c] * y
            x = S[X, c] * y - S[E, c] * x
        y = S[L + r + 1, r + 1]
        h = sqrt(x * x + y * y)
        S[X, r], S[E, r] = x / h, y / h
        S[L + r, r], S[INVERSE, r] = h, 1.0 / h
    S[HEAD, COUNT] = w - 1


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
    """Write r = H_WW⁻¹ H_Wj to R, the factor's new row to STEP.

    Returns the squared distance of row j from W.
    """
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
def solve_active(S: Matrix, L: int, w: int) -> bool:
    """R = λ_W of the active set (eq. 31); False if a limit is infinite."""
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        g = limit_of(S, i)
        if abs(g) == inf:
            return False
        S[R, k] = S[V0, i] - g
    forward(S, L, w, R)
    backward(S, L, w, R)
    return True
