"""The Cholesky factor L of H_WW, H = C P⁻¹ Cᵀ (the paper's M E⁻¹ Mᵀ), and what is solved with it.

L is kept by rows: a row brought in is a row appended, a row dropped is a chain of plane rotations
(G. H. Golub and C. F. Van Loan, Matrix Computations, section 6.5). With v₀ = −C P⁻¹q and the limits
g of the active set W

    λ_W = H_WW⁻¹ (v₀_W − g)                                                            (eq. 31)

Which row to bring in next: v = C z of the active set (eq. 32), and the rows it violates.

    v = v₀ − H_:W λ_W,     v₀ = −C P⁻¹q

takes all of H_:W, more than everything else of an iteration. The method ends at the optimum
whichever violated row comes in, so v is computed in all rows once, those violated about as much as
the most violated one become candidates, and of these alone v is computed until none is violated.

Rows of A that are others than before, as of thrusters that turn: what is made of them anew.

With the rows of I in C, of which K, H and J hold −P⁻¹, P⁻¹ and L⁻ᵀ, everything else of a row a of A
is a combination of what they have:

    K e_a = Σ a_l K e_l,    H e_a = Σ a_l H e_l,    J_a = Σ a_l J_l

A few entries in a few rows so cost a few per cent of factorising P and of all products of rows. The
active set stays; its factor is made again from H.
"""

from math import inf, sqrt

import numpy as np

from dpbench.arrays import Ints, Matrix, Vector
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ALL,
    BEFORE,
    CANDIDATES,
    CHECK,
    COUNT,
    HEAD,
    HIGH,
    INVERSE,
    LAM,
    LONGEST,
    LOW,
    MASK,
    MOST,
    MOST_MULTIPLIER,
    N_PAD,
    NARROW,
    ROWS,
    SIDE,
    STEP,
    SUM,
    UNIT,
    V0,
    ZERO_ROW,
    E,
    M,
    N,
    R,
    V,
    X,
    Z,
    add_product,
    add_scaled_row,
    compiled,
    njit_inlined,
    row_width,
)

DEPENDENT = 1e-11
"""A row no more than this share of its length away from the active ones combines from them."""
CLOSE = 1e-6
"""Below this share of its squared length a row's distance from the active ones is computed anew
from the rows themselves, because the factor has lost six digits of it."""


@compiled
def substitute_forward(S: Matrix, L: int, w: int, b: int) -> None:
    """Solve L x = b in place, L a lower triangle and b a row of the solver's work array."""
    for i in range(w):
        s = S[b, i]
        for k in range(i):
            s -= S[L + i, k] * S[b, k]
        S[b, i] = s * S[INVERSE, i]


@compiled
def substitute_backward(S: Matrix, L: int, w: int, b: int) -> None:
    """Solve Lᵀ x = b in place, L a lower triangle and b a row of the solver's work array."""
    for i in range(w - 1, -1, -1):
        x = S[b, i] * S[INVERSE, i]
        S[b, i] = x
        for k in range(i):
            S[b, k] -= S[L + i, k] * x


@compiled
def active_limit(S: Matrix, i: int) -> float:
    """Return the lower or upper limit at which active row i is held."""
    g: float = S[HIGH, i] if S[SIDE, i] > 0.0 else S[LOW, i]
    return g


@compiled
def has_wrong_sign(S: Matrix, i: int, lam: float) -> bool:
    """Return whether the sign of a multiplier contradicts the limit at which row i is active."""
    return bool((lam * S[SIDE, i] < 0.0) & (S[LOW, i] < S[HIGH, i]))


@compiled
def append_active_row(S: Matrix, L: int, w: int, i: int, side: float, pivot: float) -> int:
    """Add row i to the active set; complete its Cholesky factor row by the diagonal entry."""
    d = sqrt(pivot)
    S[L + w, w], S[INVERSE, w] = d, 1.0 / d
    S[ACTIVE, w], S[SIDE, i] = i, side
    S[HEAD, COUNT] = w + 1
    return w + 1


@compiled
def drop_active_row(S: Matrix, L: int, k: int, w: int) -> None:
    """Drop the k-th active row; update the active set's Cholesky factor by plane rotations."""
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
def refine_distance(S: Matrix, L: int, J: int, j: int, n: int, w: int) -> float:
    """Return row j's squared distance from the span of active rows, refined once."""
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
            substitute_forward(S, L, w, E)
            for k in range(w):
                S[STEP, k] += S[E, k]
            substitute_backward(S, L, w, E)
            for k in range(w):
                S[R, k] += S[E, k]
    d = 0.0
    for i in range(n):
        d += S[X, i] * S[X, i]
    return d


@compiled
def solve_direction(S: Matrix, L: int, H: int, J: int, j: int, n: int, w: int) -> float:
    """Write row j as a combination of active rows; return its squared distance from their span."""
    for k in range(w):
        S[STEP, k] = S[H + j, int(S[ACTIVE, k]) & MASK]
    substitute_forward(S, L, w, STEP)
    d = S[H + j, j]
    for k in range(w):
        S[R, k] = S[STEP, k]
        d -= S[STEP, k] * S[STEP, k]
    substitute_backward(S, L, w, R)
    if w > 0 and d < CLOSE * S[H + j, j]:
        return refine_distance(S, L, J, j, n, w)
    return float(d)


@compiled
def solve_active(S: Matrix, L: int, w: int) -> bool:
    """Compute the multipliers that hold active rows at their limits; False if one is infinite."""
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        g = active_limit(S, i)
        if abs(g) == inf:
            return False
        S[R, k] = S[V0, i] - g
    substitute_forward(S, L, w, R)
    substitute_backward(S, L, w, R)
    return True


VIOLATED = 1e-13
"""A row counts as violated beyond this many roundings of the quantities it is computed from."""
SHARE, MOST_CANDIDATES = 0.3, 24
"""A candidate is violated by this share of the most violated row; at most as many candidates."""


@njit_inlined
def add_active_rows(S: Matrix, out: int, sign: float, H: int) -> None:
    """Add or subtract C P⁻¹Cᵀ λ, summed over active rows, to or from a vector of row values."""
    for k in range(int(S[HEAD, COUNT]) & MASK):
        i = int(S[ACTIVE, k]) & MASK
        add_scaled_row(S, out, sign * S[LAM, i], H + i, ALL)


@compiled
def compute_values_on_set(S: Matrix, H: int) -> None:
    """Compute all row values v = C z at the optimum with the active rows held at their limits."""
    w = int(S[HEAD, COUNT]) & MASK
    for i in range(row_width(S)):
        S[V, i] = S[V0, i]
    add_active_rows(S, V, -1.0, H)
    for k in range(w):
        i = int(S[ACTIVE, k]) & MASK
        S[V, i] = active_limit(S, i)


@compiled
def multiply_by_rows(S: Matrix, out: int, P: int, n: int) -> None:
    """Write the values C z of all constraint rows [I; A] into a row of the work array."""
    for i in range(n):
        S[out, i] = S[Z, i]
    for i in range(n, row_width(S)):
        S[out, i] = 0.0
    add_product(S, out, P, Z, n, ROWS)


@compiled
def recompute_values(S: Matrix, P: int, H: int) -> None:
    """Recompute row values C z from z, and from them those of the unconstrained optimum."""
    multiply_by_rows(S, V, P, int(S[HEAD, N_PAD]) & MASK)
    for i in range(row_width(S)):
        S[V0, i] = S[V, i]
    add_active_rows(S, V0, 1.0, H)


@compiled
def row_violation(S: Matrix, i: int, noise: float) -> float:
    """Return how far row i violates its limits, over the row's length; 0 if within rounding."""
    over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
    e = over if over >= under else under
    if not e > 0.0:
        return 0.0
    e *= S[UNIT, i]
    g = S[HIGH, i] if over >= under else S[LOW, i]
    return float(e) if e > noise + VIOLATED * abs(g) * S[UNIT, i] else 0.0


@compiled
def find_most_violated(S: Matrix, noise: float) -> int:
    """Return the inactive row that violates its limits most for its length; −1 if none."""
    excess, width = 0.0, row_width(S)
    for i in range(width):
        over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
        excess += (over if over > 0.0 else 0.0) + (under if under > 0.0 else 0.0)
    if excess == 0.0:
        return -1
    most, worst = 0.0, -1
    for i in range(width):
        if S[SIDE, i] == 0.0:
            e = row_violation(S, i, noise)
            if e > most:
                most, worst = e, i
    return worst


@compiled
def list_candidates(S: Matrix, j: int, noise: float) -> None:
    """List inactive rows whose violation is at least 30 % of that of row j, the most violated."""
    least, count = SHARE * row_violation(S, j, noise), 0
    for i in range(row_width(S)):
        if count < MOST_CANDIDATES and i != j and S[SIDE, i] == 0.0:
            e = row_violation(S, i, noise)
            if e > 0.0 and e >= least:
                S[BEFORE, count] = i
                count += 1
    S[CHECK, CANDIDATES] = count


@compiled
def find_worst_candidate(S: Matrix, H: int, noise: float) -> int:
    """Return the most violated row of the candidate list, −1 if none; unlist satisfied ones."""
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
        e = row_violation(S, i, noise)
        if e > 0.0:
            S[BEFORE, left] = i
            left += 1
        if e > most:
            most, worst = e, i
    S[CHECK, CANDIDATES] = left
    return worst


@njit_inlined
def choose_next_row(S: Matrix, H: int, noise: float) -> int:
    """Return the next violated row to activate, from a short list while it lasts; −1 if none."""
    many = row_width(S) > NARROW
    j = find_worst_candidate(S, H, noise) if many else -1
    if j < 0:
        compute_values_on_set(S, H)
        j = find_most_violated(S, noise)
        if many and j >= 0:
            list_candidates(S, j, noise)
    return j


MANY = 8
"""Entries of changed rows a variable from which on to make everything anew takes no longer."""


@compiled
def list_changed_rows(S: Matrix, A: int, new: Matrix) -> tuple[int, int]:
    """List rows of A that differ in `new`; return how many and their nonzeros, −1 if not finite."""
    n, m = int(S[HEAD, N]), int(S[HEAD, M])
    count, entries, largest = 0, 0, 1.0
    for i in range(m):
        differs, filled, bad, most = 0, 0, 0, 0.0
        for k in range(n):
            a = new[i, k]
            differs += a != S[A + i, k]
            filled += a != 0.0
            bad += not abs(a) < inf
            most = max(most, abs(a))
        if bad:
            return -1, 0
        largest = max(largest, most)
        if differs:
            S[BEFORE, count] = i
            count, entries = count + 1, entries + filled
    S[CHECK, MOST] = MOST_MULTIPLIER / largest
    return count, entries


@compiled
def gather_changed_entries(
    S: Matrix, A: int, new: Matrix, count: int, row: Ints, share: Vector
) -> Ints:
    """Write the nonzeros of changed rows of A as column and value; return where each row begins."""
    n, first = int(S[HEAD, N]), np.empty(count + 1, np.int64)
    first[0] = 0
    for c in range(count):
        i, end = int(S[BEFORE, c]) & MASK, first[c]
        for k in range(n):
            if new[i, k] != 0.0:
                row[end], share[end] = k, new[i, k]
                end += 1
        first[c + 1] = end
    return first


@compiled
def write_changed_rows(S: Matrix, P: int, A: int, new: Matrix, count: int) -> bool:
    """Write changed rows into all copies of A; return whether a zero entry became nonzero."""
    n, n_pad, grown = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, False
    for c in range(count):
        i, terms = int(S[BEFORE, c]) & MASK, 0.0
        for k in range(n):
            a, before = new[i, k], S[A + i, k]
            terms += abs(a)
            if a != before:
                grown |= before == 0.0
                S[A + i, k] = S[P + k, n_pad + i] = a
        S[SUM, n_pad + i] = terms
    return grown


@compiled
def write_changed_columns(
    S: Matrix, block: int, rows: int, first: Ints, row: Ints, share: Vector
) -> bool:
    """Update changed rows' columns in P⁻¹Cᵀ or C P⁻¹Cᵀ; return if zeros became nonzero."""
    n_pad, grown = int(S[HEAD, N_PAD]) & MASK, False
    for r in range(block, block + rows):
        for c in range(len(first) - 1):
            total = 0.0
            for e in range(first[c], first[c + 1]):
                total += share[e] * S[r, row[e] & MASK]
            at = n_pad + (int(S[BEFORE, c]) & MASK)
            grown |= (S[r, at] == 0.0) & (total != 0.0)
            S[r, at] = total
    return grown


@compiled
def write_dependent_rows(
    S: Matrix, block: int, width: int, first: Ints, row: Ints, share: Vector
) -> None:
    """Recompute the rows that changed rows of A have in C P⁻¹Cᵀ or in its factor."""
    n_pad = int(S[HEAD, N_PAD]) & MASK
    for c in range(len(first) - 1):
        r = block + n_pad + (int(S[BEFORE, c]) & MASK)
        for i in range(width):
            S[r, i] = 0.0
        for e in range(first[c], first[c + 1]):
            a, by = share[e], block + (row[e] & MASK)
            for i in range(width):
                S[r, i] += a * S[by, i]


@compiled
def write_row_lengths(S: Matrix, H: int, first: Ints, row: Ints, share: Vector) -> bool:
    """Write changed rows' inverse P⁻¹-norms; return False if rounding may have cancelled digits."""
    n_pad, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
    for c in range(len(first) - 1):
        i, terms = n_pad + (int(S[BEFORE, c]) & MASK), 0.0
        for e in range(first[c], first[c + 1]):
            k = row[e] & MASK
            terms += share[e] * share[e] * S[H + k, k]
        if S[H + i, i] < CLOSE * terms:
            return False
        length = sqrt(S[H + i, i])
        S[UNIT, i] = 1.0 / length if length > ZERO_ROW else 1.0
    least = inf
    for i in range(width):
        least = min(least, S[UNIT, i] if S[UNIT, i] > 0.0 else inf)
    S[CHECK, LONGEST] = 1.0 / least
    return True


@compiled
def apply_row_changes(S: Matrix, K: int, P: int, H: int, J: int, A: int, new: Matrix) -> int:
    """Replace A and products with it; return 1 if nonzeros moved, −1 if P must be factorised."""
    n, n_pad, width = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, row_width(S)
    count, entries = list_changed_rows(S, A, new)
    if count <= 0 or entries > MANY * n:
        return 0 if count == 0 else -1
    row, share = np.empty(entries, np.int64), np.empty(entries)
    first = gather_changed_entries(S, A, new, count, row, share)
    grown = write_changed_rows(S, P, A, new, count)
    grown |= write_changed_columns(S, K, n, first, row, share)
    grown |= write_changed_columns(S, H, width, first, row, share)
    write_dependent_rows(S, H, width, first, row, share)
    write_dependent_rows(S, J, n_pad, first, row, share)
    return int(grown) if write_row_lengths(S, H, first, row, share) else -1
