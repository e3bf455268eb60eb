"""An active set of the compiled method: its factor, its multipliers, its point, refined.

With C = [I; A], v₀ = −C P⁻¹q and H = C P⁻¹ Cᵀ (the paper's M E⁻¹ Mᵀ), an active set W with limits g
has

    λ_W = H_WW⁻¹ (v₀_W − g),     v = C z = v₀ − H_:W λ_W                           (eq. 31, 32)

The Cholesky factor L of H_WW is kept by rows: a row brought in is a row appended, a row dropped is
a chain of plane rotations (G. H. Golub and C. F. Van Loan, Matrix Computations, section 6.5).

The answer on a set is refined in the problem's own data:

    P δz + C_Wᵀ δλ = −(P z + q + Cᵀλ),   C_W δz = g − C_W z

With e = −P⁻¹(P z + q + Cᵀλ) that is δλ = H_WW⁻¹ (C_W(z + e) − g) and δz = e − P⁻¹C_Wᵀ δλ, and in
the norm of P the correction is at most ‖e‖ + √(δλᵀ H_WW δλ).
"""

from __future__ import annotations

from math import inf, sqrt

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    CHECK,
    COUNT,
    HEAD,
    HIGH,
    INVERSE,
    ITERATIONS,
    LAM,
    LARGEST,
    LOW,
    MASK,
    N_PAD,
    PUT_ASIDE,
    SIDE,
    STEP,
    UNIT,
    V0,
    E,
    Q,
    R,
    V,
    X,
    Z,
    compiled,
    width_of,
)
from dpbench.solvers.own.active_set.spans import ALL, BOUNDS, ROWS, add_row, product

VIOLATED = 1e-13
"""A row counts as violated beyond this many roundings of the quantities it is computed from."""

CLOSE = 1e-6
"""Below this share of its squared length a row's distance from the active ones is computed anew
from the rows themselves, because the factor has lost six digits of it."""


@compiled
def forward(S: Matrix, L: int, w: int, b: int) -> None:
    for i in range(w):
        s = S[b, i]
        for k in range(i):
            s -= S[L + i, k] * S[b, k]
        S[b, i] = s * S[INVERSE, i]


@compiled
def backward(S: Matrix, L: int, w: int, b: int) -> None:
    for i in range(w - 1, -1, -1):
        x = S[b, i] * S[INVERSE, i]
        S[b, i] = x
        for k in range(i):
            S[b, k] -= S[L + i, k] * x


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
def limit_of(S: Matrix, i: int) -> float:
    g: float = S[HIGH, i] if S[SIDE, i] > 0.0 else S[LOW, i]
    return g


@compiled
def is_wrong(S: Matrix, i: int) -> bool:
    return bool(S[LAM, i] * S[SIDE, i] < 0.0 and S[LOW, i] < S[HIGH, i])


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


@compiled
def multipliers(S: Matrix, L: int) -> int:
    """λ_W of the active set if none is wrong; how many are, or −1 if a limit is infinite."""
    w, wrong = int(S[HEAD, COUNT]) & MASK, 0
    if not solve_active(S, L, w):
        return -1
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        wrong += (S[R, k] * S[SIDE, i] < 0.0) & (S[LOW, i] < S[HIGH, i])
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
            if a * S[SIDE, i] < 0.0 and S[LOW, i] < S[HIGH, i]:
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
def row_values(S: Matrix, out: int, P: int, n: int, width: int) -> None:
    """S[out] = C Z, in the problem's own rows."""
    for i in range(n):
        S[out, i] = S[Z, i]
    for i in range(n, width):
        S[out, i] = 0.0
    product(S, out, P, Z, n, ROWS)


@compiled
def add_active(S: Matrix, out: int, sign: float, H: int) -> None:
    """S[out] += sign · H_:W λ_W."""
    for k in range(int(S[HEAD, COUNT]) & MASK):
        i = int(S[ACTIVE, k]) & MASK
        add_row(S, out, sign * S[LAM, i], H + i, ALL)


@compiled
def values(S: Matrix, H: int, width: int) -> None:
    """v of the active set (eq. 32)."""
    w = int(S[HEAD, COUNT]) & MASK
    for i in range(width):
        S[V, i] = S[V0, i]
    add_active(S, V, -1.0, H)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[V, i] = limit_of(S, i)


@compiled
def most_violated(S: Matrix, width: int, noise: float) -> int:
    """The inactive row violated most in the norm of P⁻¹; −1 if there is none."""
    excess = 0.0
    for i in range(width):
        over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
        excess += (over if over > 0.0 else 0.0) + (under if under > 0.0 else 0.0)
    if excess == 0.0:
        return -1
    most, worst = 0.0, -1
    for i in range(width):
        over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
        e = over if over >= under else under
        if e > 0.0 and S[SIDE, i] == 0.0:
            e *= S[UNIT, i]
            g = S[HIGH, i] if over >= under else S[LOW, i]
            if e > most and e > noise + VIOLATED * abs(g) * S[UNIT, i]:
                most, worst = e, i
    return worst


@compiled
def _dot(S: Matrix, A: int, i: int, n: int) -> float:
    """Row i of C times Z."""
    if i < n:
        return float(S[Z, i])
    s, r = 0.0, A + i - n
    for c in range(n):
        s += S[Z, c] * S[r, c]
    return s


@compiled
def _add_row(S: Matrix, A: int, i: int, n: int, a: float) -> None:
    """X += a times row i of C."""
    if i < n:
        S[X, i] += a
        return
    r = A + i - n
    for c in range(n):
        S[X, c] += a * S[r, c]


@compiled
def refine(S: Matrix, K: int, P: int, H: int, A: int, L: int) -> float:
    """One round of refinement of Z, from v, and of λ_W; the squared correction in the norm of P."""
    n, w = int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, COUNT]) & MASK
    for i in range(n):
        S[Z, i], S[X, i], S[E, i] = S[V, i], S[Q, i], 0.0
    product(S, X, P, Z, n, BOUNDS)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        _add_row(S, A, i, n, S[LAM, i])
    if S[HEAD, ASIDE] > 0.0:
        for i in range(width_of(S)):
            if S[SIDE, i] == PUT_ASIDE:
                _add_row(S, A, i, n, S[LAM, i])
    product(S, E, K, X, n, BOUNDS)
    correction = 0.0
    for i in range(n):
        correction -= S[E, i] * S[X, i]
        S[Z, i] += S[E, i]
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[R, k] = S[STEP, k] = _dot(S, A, i, n) - limit_of(S, i)
    forward(S, L, w, R)
    backward(S, L, w, R)
    largest = 0.0
    for k in range(w):
        i, a = int(S[ACTIVE, k]) & MASK, S[R, k]
        correction += a * S[STEP, k]
        lam = S[LAM, i] + a
        S[LAM, i], largest = lam, max(largest, abs(lam))
        add_row(S, Z, -a, H + i, BOUNDS)
    S[CHECK, LARGEST] = largest
    return 2.0 * correction


@compiled
def evaluate(S: Matrix, P: int, H: int, width: int) -> None:
    """v anew from Z, in the problem's own rows, and v₀ from v."""
    row_values(S, V, P, int(S[HEAD, N_PAD]) & MASK, width)
    for i in range(width):
        S[V0, i] = S[V, i]
    add_active(S, V0, 1.0, H)


@compiled
def settle_signs(S: Matrix, L: int, rounding: float) -> int:
    """Wrong multipliers become zero where they are rounding; how many others were dropped."""
    dropped = 0
    for k in range((int(S[HEAD, COUNT]) & MASK) - 1, -1, -1):
        i = int(S[ACTIVE, k]) & MASK
        if is_wrong(S, i):
            if abs(S[LAM, i]) <= rounding * S[UNIT, i]:
                S[LAM, i] = 0.0
            else:
                drop(S, L, k, int(S[HEAD, COUNT]) & MASK)
                dropped += 1
    return dropped
