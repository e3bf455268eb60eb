"""The answer on an active set, refined in the problem's own data.

    P δz + C_Wᵀ δλ = −(P z + q + Cᵀλ),   C_W δz = g − C_W z

With e = −P⁻¹(P z + q + Cᵀλ) that is δλ = H_WW⁻¹ (C_W(z + e) − g) and δz = e − P⁻¹C_Wᵀ δλ, and in
the norm of P the correction is at most ‖e‖ + √(δλᵀ H_WW δλ). The first correction is the share ρ of
v₀ that K and L are in error by, and the next one would be ρ of the first.
"""

from __future__ import annotations

from math import sqrt

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.check import (
    largest,
)
from dpbench.solvers.own.active_set.factor import (
    backward,
    drop,
    forward,
    is_wrong,
    limit_of,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    CHECK,
    COUNT,
    HEAD,
    LAM,
    LARGEST,
    LONGEST,
    MASK,
    MOST,
    N_PAD,
    PUT_ASIDE,
    SIDE,
    STEEPEST,
    STEP,
    UNIT,
    E,
    Q,
    R,
    V,
    X,
    Z,
    compiled,
    width_of,
)
from dpbench.solvers.own.active_set.pricing import (
    VIOLATED,
    most_violated,
    row_values,
)
from dpbench.solvers.own.active_set.spans import (
    BOUNDS,
    add_row,
    product,
)

SETTLED = 1e-12
"""A correction of no more than this share of the answer leaves nothing to correct."""
NO_ERROR, ROUNDING = 1e-9, 1e-14
"""Allowed in a row, and in the gradient of 1 + ‖q‖; what rounding leaves of an answer's length."""
NEAR = 10.0
"""How much longer v₀ may be than v before v, their difference, is computed anew."""


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
    return max(2.0 * correction, 0.0)


@compiled
def settle_signs(S: Matrix, L: int, rounding: float) -> int:
    """Wrong multipliers become zero where they are rounding; how many others were dropped."""
    dropped = 0
    for k in range((int(S[HEAD, COUNT]) & MASK) - 1, -1, -1):
        i = int(S[ACTIVE, k]) & MASK
        if is_wrong(S, i, S[LAM, i]):
            if abs(S[LAM, i]) <= rounding * S[UNIT, i]:
                S[LAM, i] = 0.0
            else:
                drop(S, L, k, int(S[HEAD, COUNT]) & MASK)
                dropped += 1
    return dropped


@compiled
def is_settled(correction: float, before: float, size: float) -> bool:
    """Whether nothing is left to correct: what is squared here, and the one before this one."""
    following = correction * min(1.0, correction / before)
    return bool(following <= SETTLED * SETTLED * size * size)


@compiled
def is_clear(S: Matrix, P: int, coarse: float, size: float, correction: float) -> bool:
    """Whether the answer needs no look at every row again.

    What is left of it is no error of a row or of the gradient, and no row is violated by what v₀
    may be in error by where it is far longer than v.
    """
    n = int(S[HEAD, N_PAD]) & MASK
    error = max(sqrt(correction), ROUNDING * size)
    row, slope = error * S[CHECK, LONGEST], error * S[CHECK, STEEPEST]
    if row > NO_ERROR or (slope > NO_ERROR and slope > NO_ERROR * largest(S, Q, n)):
        return False
    if S[CHECK, LARGEST] > S[CHECK, MOST] or S[HEAD, ASIDE] > 0.0:
        return False
    fine = VIOLATED * size
    if coarse <= NEAR * fine:
        return True
    row_values(S, V, P, n)
    return bool(most_violated(S, fine) < 0)
