"""Refinement of the compiled method's answer on its active set, in the problem's own data.

    P δz + C_Wᵀ δλ = −(P z + q + Cᵀλ),   C_W δz = g − C_W z

With e = −P⁻¹(P z + q + Cᵀλ) that is δλ = H_WW⁻¹ (C_W(z + e) − g) and δz = e − P⁻¹C_Wᵀ δλ, and in
the norm of P the correction is at most ‖e‖ + √(δλᵀ H_WW δλ).
"""

from __future__ import annotations

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import (
    add_active,
    backward,
    drop,
    forward,
    is_wrong,
    limit_of,
    product,
    row_values,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    CHECK,
    COUNT,
    HEAD,
    LAM,
    LARGEST,
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
)


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
    product(S, X, P, Z, n, 0, n)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        _add_row(S, A, i, n, S[LAM, i])
    if S[HEAD, ASIDE] > 0.0:
        for i in range(S.shape[1]):
            if S[SIDE, i] == PUT_ASIDE:
                _add_row(S, A, i, n, S[LAM, i])
    product(S, E, K, X, n, 0, n)
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
        for c in range(n):
            S[Z, c] -= a * S[H + i, c]
    S[CHECK, LARGEST] = largest
    return 2.0 * correction


@compiled
def evaluate(S: Matrix, P: int, H: int, width: int) -> None:
    """v anew from Z, in the problem's own rows, and v₀ from v."""
    row_values(S, V, P, int(S[HEAD, N_PAD]) & MASK, width)
    for i in range(width):
        S[V0, i] = S[V, i]
    add_active(S, V0, 1.0, H, width)


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
