"""Start of a step: v₀, and the set of the step before, moved on and made dual feasible.

The multipliers come along with the set. What eq. 31 asks of it is another λ*, and where that has a
wrong sign λ goes towards it until the first multiplier reaches zero; that row is dropped, and λ*
is asked for again. To drop all rows that are wrong at once takes several times as many iterations,
for most of them come in again.

By hand, the point nearest (2, 1) and then the one nearest (1, −2) under z₁ ≤ 0 and z₂ − z₁ ≤ 0:

     what happens                                                      λ₀    λ₁₆   z
     the step before ends at the corner, both rows active              3     1     (0, 0)
     eq. 31 asks for −1 and −2 of them: λ₀ would be zero after ¾ of
       the way, λ₁₆ after 1/(1 + 2) = ⅓ of it. It is dropped there     5/3   0
     and eq. 31 asks for 1 of row 0 alone: no row has to come in       1     0     (0, −2)

>>> import numpy as np
>>> from dpbench.qp.program import QuadraticProgram
>>> from dpbench.solvers.own.active_set.constants import new_problem_array, write_problem
>>> from dpbench.solvers.own.active_set.kernel import solve_step
>>> from dpbench.solvers.own.active_set.layout import Z
>>> none, S = np.full(2, np.inf), new_problem_array(n=2, m=1)
>>> problem = QuadraticProgram(np.eye(2), [-2, -1], [[-1, 1]], [-9], [0], -none, [0, 9])
>>> write_problem(S, problem, keep=True)
''
>>> solve_step(S), S[LAM, [0, 16]].round(12).tolist()
(2, [3.0, 1.0])
>>> S[Q, :2] = -1, 2
>>> solve_step(S), S[LAM, [0, 16]].round(12).tolist(), S[Z, :2].round(12).tolist()
(1, [1.0, 0.0], [0.0, -2.0])

Whether rounding decides which of the rows that an answer meets are active, and where it lies.

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
>>> from dpbench.solvers.own.active_set.constants import new_problem_array, write_problem
>>> from dpbench.solvers.own.active_set.kernel import solve_step
>>> from dpbench.solvers.own.active_set.layout import DOUBTFUL
>>> def is_doubtful(row, low, high):
...     S, one = new_problem_array(n=2, m=1), np.ones(2)
...     meeting = np.eye(2), [-3, -3.5], [row], [low], [high], -9 * one, one
...     write_problem(S, QuadraticProgram(*meeting), keep=False)
...     return solve_step(S) == DOUBTFUL
>>> is_doubtful([1, 1], -9, 2), is_doubtful([1, 1e-6], -9, 1 + 1e-6)
(False, True)
>>> is_doubtful([1, 1], 2, 9), is_doubtful([1, 1 / 3], 4 / 3, 9)
(False, True)
"""

from math import floor, inf, sqrt

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.factor import (
    CLOSE,
    DEPENDENT,
    append_active_row,
    compute_values_on_set,
    drop_active_row,
    find_most_violated,
    has_wrong_sign,
    solve_active,
    solve_direction,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ALL,
    ASIDE,
    BEFORE,
    BLOCK,
    BLOCK_ROWS,
    CHECK,
    COUNT,
    CROSSED,
    HEAD,
    HIGH,
    INVERSE,
    ITERATIONS,
    KEEP,
    LAM,
    LENGTH,
    LOW,
    MASK,
    N_PAD,
    NOT_FINITE,
    SHARES,
    SIDE,
    STALE,
    STEP,
    UNIT,
    V0,
    VECTORS,
    M,
    N,
    Q,
    R,
    V,
    add_product,
    compiled,
    row_width,
)


@compiled
def norm_of_values(S: Matrix, row: int) -> float:
    """Return the 2-norm of constraint row values, each divided by its row's P⁻¹-norm."""
    square = 0.0
    for i in range(row_width(S)):
        v = S[row, i] * S[UNIT, i]
        square += v * v
    return sqrt(square)


@compiled
def clear_active_set(S: Matrix) -> None:
    """Empty the active set and set all multipliers to zero."""
    for i in range(row_width(S)):
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = S[HEAD, ASIDE] = S[HEAD, STALE] = 0.0


@compiled
def compute_unconstrained_values(S: Matrix, K: int) -> float:
    """Compute all row values at the unconstrained optimum; return their norm, < 0 for bad data."""
    n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
    if S[HEAD, STALE] > 0.0 or S[HEAD, KEEP] == 0.0 or S[HEAD, ASIDE] > 0.0:
        clear_active_set(S)
    S[HEAD, ITERATIONS] = 0.0
    for i in range(width):
        S[V0, i] = 0.0
    add_product(S, V0, K, Q, n, ALL)
    size, bad = norm_of_values(S, V0), 0
    for i in range(width):
        bad += not ((S[LOW, i] <= S[HIGH, i]) & (S[LOW, i] < inf) & (S[HIGH, i] > -inf))
    if not size < inf:
        return NOT_FINITE
    S[CHECK, LENGTH] = size
    return CROSSED if bad else size


@compiled
def try_multipliers(S: Matrix, L: int) -> int:
    """Compute the active rows' multipliers; return how many have wrong signs, −1 if impossible."""
    w, wrong = int(S[HEAD, COUNT]) & MASK, 0
    if not solve_active(S, L, w):
        return -1
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        wrong += has_wrong_sign(S, i, S[R, k])
    if wrong == 0:
        for k in range(w):
            S[LAM, int(S[ACTIVE, k]) & MASK] = S[R, k]
    return wrong


@compiled
def restore_dual_feasibility(S: Matrix, L: int) -> None:
    """Move multipliers to those of the active set, dropping rows until all signs are right."""
    while True:
        w = int(S[HEAD, COUNT]) & MASK
        if not solve_active(S, L, w):
            return
        first, t = -1, 1.0
        for k in range(w):
            i, a = int(S[ACTIVE, k]) & MASK, S[R, k]
            if has_wrong_sign(S, i, a):
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
        drop_active_row(S, L, first, w)
        S[HEAD, ITERATIONS] += 1


@compiled
def add_to_start(S: Matrix, L: int, H: int, i: int, side: float, lam: float) -> None:
    """Add row i to the starting active set, unless in it, without a limit or nearly dependent."""
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
        append_active_row(S, L, w, i, side, d)
        S[LAM, i] = lam


@compiled
def empty_active_set(S: Matrix) -> int:
    """Make all rows inactive, keeping a list of their numbers and multipliers; return how many."""
    w = int(S[HEAD, COUNT]) & MASK
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[BEFORE, k], S[R, k] = (i + 1) * S[SIDE, i], S[LAM, i]
        S[SIDE, i] = S[LAM, i] = 0.0
    S[HEAD, COUNT] = 0
    return w


@compiled
def refactorise_active_set(S: Matrix, L: int, H: int) -> None:
    """Compute the active set's Cholesky factor anew after rows of A have changed."""
    for k in range(empty_active_set(S)):
        side = 1.0 if S[BEFORE, k] > 0.0 else -1.0
        add_to_start(S, L, H, (int(abs(S[BEFORE, k])) - 1) & MASK, side, S[R, k])


@compiled
def shift_active_set(S: Matrix, L: int, H: int) -> None:
    """Shift the active set in S an increment earlier, last kept; L, H: where factor, H begin."""
    n, n_pad, m = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M])
    block, block_rows = int(S[HEAD, BLOCK]) & MASK, int(S[HEAD, BLOCK_ROWS]) & MASK
    for k in range(empty_active_set(S)):
        side = 1.0 if S[BEFORE, k] > 0.0 else -1.0
        i = (int(abs(S[BEFORE, k])) - 1) & MASK
        first, end, by = (0, n, block) if i < n_pad else (n_pad, n_pad + m, block_rows)
        if i - first >= by:
            add_to_start(S, L, H, (i - by) & MASK, side, S[R, k])
        if i >= end - by:
            add_to_start(S, L, H, i, side, S[R, k])


@compiled
def add_equalities_to_start(S: Matrix, L: int, H: int) -> None:
    """Add all independent rows with equal limits to the starting active set."""
    count, width = 0, row_width(S)
    for i in range(width):
        count += (S[LOW, i] == S[HIGH, i]) & (S[SIDE, i] == 0.0)
    for i in range(width if count else 0):
        if S[LOW, i] == S[HIGH, i]:
            add_to_start(S, L, H, i, 1.0, 0.0)


@compiled
def choose_start(S: Matrix, L: int, H: int, noise: float) -> int:
    """Choose the starting active set and solve on it; return the most violated row, −1 if none."""
    add_equalities_to_start(S, L, H)
    if S[HEAD, COUNT] > 0.0:
        wrong = try_multipliers(S, L)
        if wrong != 0:
            shift_active_set(S, L, H)
            add_equalities_to_start(S, L, H)
            restore_dual_feasibility(S, L)
    compute_values_on_set(S, H)
    return find_most_violated(S, noise)


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
def is_degenerate_vertex(S: Matrix, L: int, H: int, J: int, size: float) -> bool:
    """Return whether rounding may decide which constraint rows near their limits are active."""
    near, w, width = 0, int(S[HEAD, COUNT]) & MASK, row_width(S)
    for i in range(width):
        u, v = S[UNIT, i], S[V, i]
        little = NEAR * (abs(v) * u + size)
        near += ((S[HIGH, i] - v) * u <= little) | ((v - S[LOW, i]) * u <= little)
    for k in range(w):
        if S[INVERSE, k] * STEEP > S[UNIT, int(S[ACTIVE, k]) & MASK]:
            return True
    if near == w:
        return False
    crowded = near > w + MOST_EXTRA or not is_vertex_stable(S, L, H, J, size)
    # Rows that were only looked at leave the set again.
    for k in range(w, int(S[HEAD, COUNT]) & MASK):
        S[SIDE, int(S[ACTIVE, k]) & MASK] = 0.0
    S[HEAD, COUNT] = w
    return bool(crowded)


@compiled
def side_near_limit(S: Matrix, i: int, size: float) -> float:
    """Return the limit that row i's value is near: 1 upper, −1 lower, 0 neither, 2 both."""
    u, v = S[UNIT, i], S[V, i]
    little = NEAR * (abs(v) * u + size)
    high, low = (S[HIGH, i] - v) * u <= little, (v - S[LOW, i]) * u <= little
    return 2.0 if high and low else 1.0 if high else -1.0 if low else 0.0


@compiled
def is_vertex_stable(S: Matrix, L: int, H: int, J: int, size: float) -> bool:
    """Return whether rounding cannot move the optimum where inactive rows are near limits too."""
    n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
    for k in range(int(S[HEAD, COUNT]) & MASK):
        i = int(S[ACTIVE, k]) & MASK
        if S[LOW, i] < S[HIGH, i] and side_near_limit(S, i, size) == 2.0:
            return False
    rest = 0
    for i in range(width):
        side = side_near_limit(S, i, size) if S[SIDE, i] == 0.0 else 0.0
        if side == 2.0 or (side != 0.0 and not S[H + i, i] > 0.0):
            return False
        if side != 0.0:
            w = int(S[HEAD, COUNT]) & MASK
            d = solve_direction(S, L, H, J, i, n, w) if w < int(S[HEAD, N]) else 0.0
            if d > STEEP * STEEP * S[H + i, i]:
                for k in range(w):
                    S[L + w, k] = S[STEP, k]
                append_active_row(S, L, w, i, side, d)
            elif d > DEPENDENT * DEPENDENT * S[H + i, i]:
                return False
            else:
                S[BEFORE, rest] = i
                rest += 1
    w = int(S[HEAD, COUNT]) & MASK
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[V0, k] = inf if S[LOW, i] == S[HIGH, i] else 0.0
    rest = remove_squeezing_rows(S, L, H, J, rest, size)
    if rest > MOST_DEPENDENT:
        return False
    for r in range(rest):
        j = int(S[BEFORE, r]) & MASK
        solve_direction(S, L, H, J, j, n, w)
        write_signed_shares(S, r, j, side_near_limit(S, j, size), w)
    return bool(is_stable_under_exchange(S, rest, w) and has_inward_direction(S, rest, w))


@compiled
def remove_squeezing_rows(S: Matrix, L: int, H: int, J: int, rest: int, size: float) -> int:
    """Unlist rows that, with active rows, force an exact equality; return how many are left."""
    n, w, left = int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, COUNT]) & MASK, rest
    A = J + row_width(S)
    for _ in range(rest):
        before, left = left, 0
        for r in range(before):
            i = int(S[BEFORE, r]) & MASK
            solve_direction(S, L, H, J, i, n, w)
            if not forces_equality(S, A, i, side_near_limit(S, i, size), n, w):
                S[BEFORE, left] = i
                left += 1
        if left == before:
            break
    return left


@compiled
def forces_equality(S: Matrix, A: int, j: int, side: float, n: int, w: int) -> bool:
    """Return whether row j at its limit leaves the active rows it combines no room to move."""
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        if S[V0, k] < inf and side * S[SIDE, i] * S[R, k] * S[UNIT, j] > NONE * S[UNIT, i]:
            return False
    for c in range(n + 1):
        total = row_entry(S, A, j, side, c, n)
        whole = total == floor(total) and abs(total) < LARGEST_WHOLE
        for k in range(w):
            share = floor(S[R, k] + 0.5)
            if abs(S[R, k] - share) > NONE:
                return False
            if share != 0.0:
                i = int(S[ACTIVE, k]) & MASK
                x = row_entry(S, A, i, S[SIDE, i], c, n)
                whole &= x == floor(x) and abs(share * x) < LARGEST_WHOLE
                total -= share * x
        if total != 0.0 or not whole:
            return False
    for k in range(w):
        if abs(S[R, k]) > NONE:
            S[V0, k] = inf
    return True


@compiled
def row_entry(S: Matrix, A: int, i: int, side: float, column: int, n: int) -> float:
    """Return entry `column` of row i of the constraint matrix [I; A], or for column n its limit."""
    if column == n:
        return float(S[HIGH, i] if side > 0.0 else S[LOW, i])
    if i < n:
        return 1.0 if i == column else 0.0
    return float(S[A + i - n, column])


@compiled
def write_signed_shares(S: Matrix, r: int, j: int, side: float, w: int) -> None:
    """Store inactive row j as a combination of active rows: coefficients, signed by limit."""
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        share = side * S[SIDE, i] * S[R, k] * S[UNIT, j] / S[UNIT, i]
        S[SHARES + r, k] = share if abs(share) > NONE and S[V0, k] < inf else 0.0


@compiled
def is_stable_under_exchange(S: Matrix, rest: int, w: int) -> bool:
    """Return whether no exchange of active rows leaves nearly dependent ones."""
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
                if partners > 1 or not has_stable_minors(S, SHARES + r, SHARES + q, w):
                    return False
    return True


@compiled
def has_stable_minors(S: Matrix, r: int, q: int, w: int) -> bool:
    """Return whether two rows of coefficients are clearly independent or exactly dependent."""
    for k in range(w):
        if S[r, k] != 0.0 or S[q, k] != 0.0:
            for c in range(k):
                minor = abs(S[r, k] * S[q, c] - S[r, c] * S[q, k])
                if NONE < minor < STEEP:
                    return False
    return True


@compiled
def has_inward_direction(S: Matrix, rest: int, w: int) -> bool:
    """Return whether one direction leads into the feasible set from all rows near their limits."""
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
