"""The optimality conditions of the compiled method's answer, in the problem's own data.

With r = P z + q + Cᵀλ and g_i the limit that the sign of λ_i names, an answer is an optimum if

    C z ≤ limits,   r = 0,   |λ_i|·|c_iᵀz − g_i| = 0

each but for what is allowed of the size of the terms it is computed from. What the method holds of
H and its factor does not enter, so that nothing they have lost can go unseen.

An answer is refined on its active set by the equations in `kernel`. With e = −P⁻¹(P z + q + Cᵀλ)
that is δλ = H_WW⁻¹ (C_W(z + e) − g) and δz = e − P⁻¹C_Wᵀ δλ, and in the norm of P the correction is
at most ‖e‖ + √(δλᵀ H_WW δλ). The first correction is the share ρ of v₀ that K and L are in error
by, and the next one would be ρ of the first.
"""

from math import inf, sqrt

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import (
    VIOLATED,
    active_limit,
    drop_active_row,
    find_most_violated,
    has_wrong_sign,
    multiply_by_rows,
    substitute_backward,
    substitute_forward,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    BOUNDS,
    CHECK,
    COUNT,
    HEAD,
    HIGH,
    LAM,
    LARGEST,
    LENGTH,
    LONGEST,
    LOW,
    MASK,
    MOST,
    N_PAD,
    PUT_ASIDE,
    SIDE,
    STEEPEST,
    STEP,
    SUM,
    UNIT,
    WORST,
    E,
    Q,
    R,
    V,
    X,
    Z,
    add_product,
    add_scaled_row,
    compiled,
    row_width,
)

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
"""Half of the tightest tolerance that answers are held to, of a variable's room (`error_units`)."""
PRODUCT, ROUNDING = 1e-7, 1e-13
"""A multiplier may have a slack up to this product, or of this share of the row's terms: a
large multiplier times rounding is no error."""


@compiled
def largest_magnitude(S: Matrix, row: int, n: int) -> float:
    """Return the largest absolute value of the first n entries of a work array row."""
    most = 0.0
    for i in range(n):
        most = max(most, abs(S[row, i]))
    return most


@compiled
def excess_of_rows(S: Matrix, P: int, n: int, width: int) -> float:
    """Return the largest row violation or complementarity error, as a ratio to its tolerance.

    The inactive row that does so most by its violation is left in `WORST`, −1 if there is none.
    """
    size, most = largest_magnitude(S, Z, n), 0.0
    S[CHECK, WORST] = -1.0
    multiply_by_rows(S, E, P, n)
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
def gradient_entry(S: Matrix, P: int, i: int, n: int, width: int) -> tuple[float, float]:
    """Return entry i of the Lagrangian's gradient P z + q + Cᵀλ, and the sum of absolute terms."""
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
    """Return the largest entry of the gradient P z + q + Cᵀλ, as a ratio to its tolerance."""
    size, cost, most = largest_magnitude(S, Z, n), largest_magnitude(S, Q, n), 0.0
    for i in range(n):
        r, terms = gradient_entry(S, P, i, n, width)
        r, rounding = abs(r), EPSILON * terms
        if not r < inf:
            return inf
        if terms > 0.0:
            allowed = min(DUAL * (cost + S[SUM, i] * size), SMALL * (1.0 + cost))
            most = max(most, r / max(allowed, rounding))
            most = max(most, (r + 0.5 * rounding) / (DUAL_AT_MOST * (1.0 + cost)))
    return most


@compiled
def is_near_optimum(S: Matrix, P: int, H: int, n: int, width: int) -> bool:
    """Return whether the residual r = P z + q + Cᵀλ proves z near the optimum on the active rows.

    With r and its rounding, |z_i − z*_i| ≤ √((P⁻¹)_ii · |r|ᵀ|P⁻¹||r|).
    """
    square, widest = 0.0, 0.0
    for i in range(n):
        r, terms = gradient_entry(S, P, i, n, width)
        S[E, i] = abs(r) + EPSILON * terms
        room = max(1.0, 0.5 * (S[HIGH, i] - S[LOW, i]))
        widest = max(widest, S[H + i, i] / (room * room if room < inf else 1.0))
    for i in range(n):
        for k in range(n):
            square += S[E, i] * abs(S[H + i, k]) * S[E, k]
    return bool(widest * square <= WRONG * WRONG)


@compiled
def largest_excess(S: Matrix, P: int, n: int, width: int) -> float:
    """Return the largest ratio of an optimality residual to its tolerance; optimal up to 1."""
    gradient = excess_of_gradient(S, P, n, width)
    return max(gradient, excess_of_rows(S, P, n, width)) if gradient < inf else inf


SETTLED = 1e-12
"""A correction of no more than this share of the answer leaves nothing to correct."""
NO_ERROR, LEAST_ERROR = 1e-9, 1e-14
"""Allowed in a row, and in the gradient of 1 + ‖q‖; what rounding leaves of an answer's length."""
NEAR = 10.0
"""How much longer v₀ may be than v before v, their difference, is computed anew."""


@compiled
def _row_times_z(S: Matrix, A: int, i: int, n: int) -> float:
    """Return the value of constraint row i of [I; A] at the answer z."""
    if i < n:
        return float(S[Z, i])
    s, r = 0.0, A + i - n
    for c in range(n):
        s += S[Z, c] * S[r, c]
    return s


@compiled
def _add_multiple_of_row(S: Matrix, A: int, i: int, n: int, a: float) -> None:
    """Add a times row i of the constraint matrix [I; A] to a vector of the work array."""
    if i < n:
        S[X, i] += a
        return
    r = A + i - n
    for c in range(n):
        S[X, c] += a * S[r, c]


@compiled
def refine_answer(S: Matrix, K: int, P: int, H: int, A: int, L: int) -> float:
    """Refine z and active multipliers once by residuals; return the squared change in P's norm."""
    n, w = int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, COUNT]) & MASK
    for i in range(n):
        S[Z, i], S[X, i], S[E, i] = S[V, i], S[Q, i], 0.0
    add_product(S, X, P, Z, n, BOUNDS)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        _add_multiple_of_row(S, A, i, n, S[LAM, i])
    if S[HEAD, ASIDE] > 0.0:
        for i in range(row_width(S)):
            if S[SIDE, i] == PUT_ASIDE:
                _add_multiple_of_row(S, A, i, n, S[LAM, i])
    add_product(S, E, K, X, n, BOUNDS)
    correction = 0.0
    for i in range(n):
        correction -= S[E, i] * S[X, i]
        S[Z, i] += S[E, i]
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[R, k] = S[STEP, k] = _row_times_z(S, A, i, n) - active_limit(S, i)
    substitute_forward(S, L, w, R)
    substitute_backward(S, L, w, R)
    largest = 0.0
    for k in range(w):
        i, a = int(S[ACTIVE, k]) & MASK, S[R, k]
        correction += a * S[STEP, k]
        lam = S[LAM, i] + a
        S[LAM, i], largest = lam, max(largest, abs(lam))
        add_scaled_row(S, Z, -a, H + i, BOUNDS)
    S[CHECK, LARGEST] = largest
    return max(2.0 * correction, 0.0)


@compiled
def correct_wrong_signs(S: Matrix, L: int, rounding: float) -> int:
    """Zero wrong-signed multipliers within rounding, drop others' rows; return how many drop."""
    dropped = 0
    for k in range((int(S[HEAD, COUNT]) & MASK) - 1, -1, -1):
        i = int(S[ACTIVE, k]) & MASK
        if has_wrong_sign(S, i, S[LAM, i]):
            if abs(S[LAM, i]) <= rounding * S[UNIT, i]:
                S[LAM, i] = 0.0
            else:
                drop_active_row(S, L, k, int(S[HEAD, COUNT]) & MASK)
                dropped += 1
    return dropped


@compiled
def is_refinement_settled(correction: float, before: float, size: float) -> bool:
    """Predict from two squared corrections whether the next one would be below rounding."""
    following = correction * min(1.0, correction / before)
    return bool(following <= SETTLED * SETTLED * size * size)


@compiled
def is_clearly_optimal(S: Matrix, P: int, coarse: float, size: float, correction: float) -> bool:
    """Return whether the refined answer is certainly optimal, without a check of all rows.

    What is left of it is no error of a row or of the gradient, and no row is violated by what v₀
    may be in error by where it is far longer than v.
    """
    n = int(S[HEAD, N_PAD]) & MASK
    error = max(sqrt(correction), LEAST_ERROR * size)
    row, slope = error * S[CHECK, LONGEST], error * S[CHECK, STEEPEST]
    if row > NO_ERROR or (slope > NO_ERROR and slope > NO_ERROR * largest_magnitude(S, Q, n)):
        return False
    if S[CHECK, LARGEST] > S[CHECK, MOST] or S[HEAD, ASIDE] > 0.0:
        return False
    fine = VIOLATED * size
    if coarse <= NEAR * fine:
        return True
    multiply_by_rows(S, V, P, n)
    return bool(find_most_violated(S, fine) < 0)
