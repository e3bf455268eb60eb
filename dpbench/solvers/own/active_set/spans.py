"""Products with matrices whose rows are zero in long stretches, as slacks make them.

Behind a row of K, [P Aᵀ] and H, in the columns `width` and on, stands where it is not zero: how
many spans there are before column n_pad, how many in all, and the first column and the end of each.
Spans are whole vectors of `LANES` columns, with no gap between them that is cheaper to cross than
to leave out. K and [P Aᵀ] are gone through four rows at a time, which have their spans in common,
behind the first of them; rows that are `NARROW` are gone through whole. A row without zeros has one
span before n_pad and one behind it:

    n_pad = 16, width = 64     0 … 15 16 … 31 32 … 47 48 … 63 │ 64 65 66 67 68 69 70 71 72 73
    a row of zeros and ×       × 0        0 0   0 × ×      0  │  1  2  0  8 32 48
    another                    × ×      × ×   × × × ×    × ×  │  1  2  0 16 16 64
"""

from __future__ import annotations

from dpbench.arrays import Matrix
from dpbench.solvers.own.active_set.layout import (
    HEAD,
    MASK,
    N_PAD,
    TAIL,
    compiled,
    inlined,
    width_of,
)

GROUP = 4
"""Rows of K and of [P Aᵀ] with spans in common: a sum over four costs one look at the result."""
NARROW = 64
"""Of no more columns than these all are gone through: to choose some takes as long."""
LANES, GAP = 8, 32
"""Columns of a vector, and columns that it takes no longer to go through than to leave out."""
SPANS_BEFORE, SPANS = 3, TAIL // 2 - 1
"""At most as many before column n_pad, and in all; the last one takes in what would be another."""
BOUNDS, ROWS, ALL = 0, 1, 2
"""Parts of a row: the columns of the bounds, of the rows of A, and both."""


@compiled
def mark(S: Matrix, first: int, end: int, step: int, n: int) -> None:
    """Write the spans of rows `first` to `end` of S, `step` rows at a time."""
    width = width_of(S)
    for r in range(first, end, step):
        count = 0
        for half in range(2):
            start, stop = (0, n) if half == 0 else (n, width)
            least, most = count, SPANS_BEFORE if half == 0 else SPANS
            for c in range(start, stop, LANES):
                if not any_entry(S, r, r + step, c):
                    continue
                ahead = width + 2 * count + 1
                if count > least and (count == most or c - S[r, ahead] < GAP):
                    S[r, ahead] = c + LANES
                else:
                    S[r, ahead + 1], S[r, ahead + 2] = c, c + LANES
                    count += 1
            S[r, width + half] = count


@compiled
def mark_all(S: Matrix, K: int, P: int, H: int, J: int, n: int) -> None:
    """Write the spans of K, [P Aᵀ] and H."""
    mark(S, K, P, GROUP, n)
    mark(S, P, H, GROUP, n)
    mark(S, H, J, 1, n)


@compiled
def any_entry(S: Matrix, first: int, end: int, column: int) -> bool:
    """Whether any of some rows has an entry in the vector that begins at a column."""
    for r in range(first, end):
        for c in range(column, column + LANES):
            if S[r, c] != 0.0:
                return True
    return False


@compiled
def spans_of(S: Matrix, r: int, width: int, part: int) -> tuple[int, int]:
    """Return the columns of S in which the spans of a part of row r begin and end."""
    first = int(S[r, width]) if part == ROWS else 0
    end = int(S[r, width]) if part == BOUNDS else int(S[r, width + 1])
    return (width + 2 + 2 * first) & MASK, (width + 2 + 2 * end) & MASK


@compiled
def product(S: Matrix, out: int, first: int, by: int, n: int, part: int) -> None:
    """S[out] += Σ_j S[by, j] · S[first + j] over n rows of K or [P Aᵀ], on a part of them."""
    width = width_of(S)
    for j in range(0, n, GROUP):
        a, b, c, d = S[by, j], S[by, j + 1], S[by, j + 2], S[by, j + 3]
        r = first + j
        if width <= NARROW:
            for i in range(n if part == ROWS else 0, n if part == BOUNDS else width):
                S[out, i] += a * S[r, i] + b * S[r + 1, i] + c * S[r + 2, i] + d * S[r + 3, i]
            continue
        span, end = spans_of(S, r, width, part)
        while span < end:
            for i in range(int(S[r, span]) & MASK, int(S[r, span + 1]) & MASK):
                S[out, i] += a * S[r, i] + b * S[r + 1, i] + c * S[r + 2, i] + d * S[r + 3, i]
            span += 2


@inlined
def add_row(S: Matrix, out: int, a: float, r: int, part: int) -> None:
    """S[out] += a · S[r] for a row of H, on a part of the columns."""
    width = width_of(S)
    if width <= NARROW:
        n = int(S[HEAD, N_PAD]) & MASK
        for i in range(n if part == ROWS else 0, n if part == BOUNDS else width):
            S[out, i] += a * S[r, i]
        return
    span, end = spans_of(S, r, width, part)
    while span < end:
        for i in range(int(S[r, span]) & MASK, int(S[r, span + 1]) & MASK):
            S[out, i] += a * S[r, i]
        span += 2
