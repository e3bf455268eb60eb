"""The optimality conditions of the compiled method's answer, in the problem's own data.

With r = P z + q + Cᵀλ and g_i the limit that the sign of λ_i names, an answer is an optimum if

    C z ≤ limits,   r = 0,   |λ_i|·|c_iᵀz − g_i| = 0

each but for what is allowed of the size of the terms it is computed from. What the method holds of
H and its factor does not enter, so that nothing they have lost can go unseen.
"""

from __future__ import annotations

from math import inf

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.layout import (
    CHECK,
    HIGH,
    LAM,
    LENGTH,
    LOW,
    SIDE,
    SUM,
    UNIT,
    WORST,
    E,
    Q,
    Z,
    compiled,
)
from dpbench.solvers.own.active_set.pricing import row_values

PRIMAL, DUAL = 1e-13, 1e-9
"""Shares allowed of the terms of a row value, and of q and P z."""
LOST, FLOOR = 1e-15, 1e-9
"""What rounding of −P⁻¹q leaves in a row value, of their lengths, and what of it is allowed."""
SMALL, EPSILON = 5e-9, 2.3e-16
"""Allowed of 1 + ‖q‖ in r, in which a referee counts; and of the terms r is summed of where
rounding of them is more."""
PRIMAL_AT_MOST, DUAL_AT_MOST = 2e-7, 9e-7
"""Allowed in any case of a violation, and of 1 + ‖q‖ in r with half a unit of rounding: below the
tightest tolerance that answers are held to, 1e-6."""
WRONG = 5e-7
"""Half of the tightest tolerance that answers are held to, of a variable's room (`unit_of`)."""
PRODUCT, ROUNDING = 1e-7, 1e-13
"""A multiplier may have a slack up to this product, or of this share of the row's terms: a
large multiplier times rounding is no error."""


@compiled
def largest(S: Matrix, row: int, n: int) -> float:
    """Return the largest absolute value of the first n entries of a row."""
    most = 0.0
    for i in range(n):
        most = max(most, abs(S[row, i]))
    return most


@compiled
def excess_of_rows(S: Matrix, P: int, n: int, width: int) -> float:
    """Return the most by which a row exceeds the allowed violation and complementarity.

    The inactive row that does so most by its violation is left in `WORST`, −1 if there is none.
    """
    size, most = largest(S, Z, n), 0.0
    S[CHECK, WORST] = -1.0
    row_values(S, E, P, n)
    for i in range(width):
        v, a = S[E, i], S[LAM, i]
        terms = size if i < n else size * S[SUM, i]
        over, under = v - S[HIGH, i], S[LOW, i] - v
        beyond, g = (over, S[HIGH, i]) if over >= under else (under, S[LOW, i])
        if beyond > 0.0:
            floor = min(LOST * S[CHECK, LENGTH] / S[UNIT, i], FLOOR)
            share = beyond / min(PRIMAL * (abs(g) + terms) + floor, PRIMAL_AT_MOST)
            if share > max(most, 1.0) and S[SIDE, i] == 0.0:
                S[CHECK, WORST] = i
            most = max(most, share)
        if a != 0.0:
            g = S[HIGH, i] if a > 0.0 else S[LOW, i]
            if abs(g) == inf:
                return inf
            slack = abs(v - g)
            if slack > ROUNDING * (abs(g) + terms):
                most = max(most, abs(a) * slack / PRODUCT)
    return most


@compiled
def gradient(S: Matrix, P: int, i: int, n: int, width: int) -> tuple[float, float]:
    """Entry i of r, and the size of the terms it is the sum of."""
    r, terms = S[Q, i] + S[LAM, i], abs(S[LAM, i])
    for k in range(n):
        a = S[P + i, k] * S[Z, k]
        r, terms = r + a, terms + abs(a)
    for k in range(n, width):
        a = S[P + i, k] * S[LAM, k]
        r, terms = r + a, terms + abs(a)
    return r, terms


@compiled
def excess_of_gradient(S: Matrix, P: int, n: int, width: int) -> float:
    """Return the most by which an entry of r exceeds what is allowed."""
    size, cost, most = largest(S, Z, n), largest(S, Q, n), 0.0
    for i in range(n):
        r, terms = gradient(S, P, i, n, width)
        r, rounding = abs(r), EPSILON * terms
        if not r < inf:
            return inf
        if terms > 0.0:
            allowed = min(DUAL * (cost + S[SUM, i] * size), SMALL * (1.0 + cost))
            most = max(most, r / max(allowed, rounding))
            most = max(most, (r + 0.5 * rounding) / (DUAL_AT_MOST * (1.0 + cost)))
    return most


@compiled
def is_near(S: Matrix, P: int, H: int, n: int, width: int) -> bool:
    """Return whether r leaves the answer near the optimum of its active rows.

    It does where P is not too ill-conditioned.

    With r and its rounding, |z_i − z*_i| ≤ √((P⁻¹)_ii · |r|ᵀ|P⁻¹||r|).
    """
    square, widest = 0.0, 0.0
    for i in range(n):
        r, terms = gradient(S, P, i, n, width)
        S[E, i] = abs(r) + EPSILON * terms
        room = max(1.0, 0.5 * (S[HIGH, i] - S[LOW, i]))
        widest = max(widest, S[H + i, i] / (room * room if room < inf else 1.0))
    for i in range(n):
        for k in range(n):
            square += S[E, i] * abs(S[H + i, k]) * S[E, k]
    return bool(widest * square <= WRONG * WRONG)


@compiled
def excess(S: Matrix, P: int, n: int, width: int) -> float:
    """Return the most by which (Z, λ) exceeds what is allowed: up to 1 it is an optimum."""
    gradient = excess_of_gradient(S, P, n, width)
    return max(gradient, excess_of_rows(S, P, n, width)) if gradient < inf else inf
