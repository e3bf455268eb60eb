"""The array S on which the compiled active-set method works, and how its functions are compiled.

S is one array so that a step is one call with one argument, which is what a call costs most for.
With n variables and m rows, both padded to multiples of 16, C = [I; A] has `width` places for rows:

    i of a row of C    0 … n−1          n_pad … n_pad+m−1           width = n_pad + m_pad
                       │bounds│ padding │rows of A│ padding │

    rows of S                     what stands there                           columns
     0  HEAD     1  CHECK         sizes, counters, switches: slots below      slot
     2  Q       17  Z             q, z                                        variable
     3  LOW      4  HIGH          [lb; l], [ub; u]                            i
     5  UNIT     6  SUM           1/√H_ii, Σ|entries| of a column of [P Aᵀ]   i
     7  V0       8  V             −C P⁻¹q, C z                                i
     9  LAM     10  SIDE          λ, and +1 active at HIGH, −1 at LOW, 0 not  i
    11  ACTIVE  12  INVERSE       i of the k-th active row, 1/L_kk            k
    13  R       14  STEP          scratch                                     k
    15  X       16  E             scratch                                     k or variable or i
    18  BEFORE                    what λ or SIDE was, or a list of rows       i or k
    19 … 82  SHARES               of rows in the active ones (`start`)        k
    ── blocks ─────────────────────────────────────────────────────────────────────
    K   n_pad rows                −P⁻¹Cᵀ                                      i
    P   n_pad rows                [P Aᵀ]                                      i
    H   width rows                C P⁻¹Cᵀ, row i                              i
    J   width rows                row i of C L⁻ᵀ, P = L Lᵀ                    variable
    A   m_pad rows                A                                           variable
    L   n_pad rows                Cholesky factor of H_WW, row k              k

W are the active rows in the order they came; what is indexed by k has `COUNT` entries.

Products with matrices whose rows are zero in long stretches, as slacks make them.

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

import marshal
import zlib
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import TypeVar, cast

from dpbench.arrays import Matrix
from dpbench.kernel_cache import njit

# Rows of vectors. X, E, R and STEP are scratch.
HEAD, CHECK, Q, LOW, HIGH, UNIT, SUM, V0, V = range(9)
LAM, SIDE, ACTIVE, INVERSE, R, STEP, X, E, Z, BEFORE = range(9, 19)
SHARES, VECTORS = 19, 83
# Slots of row HEAD, and of row CHECK; there is room for sixteen in a row.
N, N_PAD, M, COUNT, ASIDE, ITERATIONS, LIMIT, KEEP, STALE, BLOCK, BLOCK_ROWS, STAMP = range(12)
LONGEST, STEEPEST, MOST, LARGEST, LENGTH, WORST, CANDIDATES = range(7)
PUT_ASIDE = 2.0
"""SIDE of a row that is the active ones written twice: not active, its multiplier part of v₀."""
TAIL = 16
"""Columns behind the `width` first ones, where rows of K, [P Aᵀ] and H say which of their entries
are not zero: how many spans of them there are before column n_pad and in all, then the spans."""
MOST_MULTIPLIER = 1e5
"""What a multiplier may be for its rounding to be no more than 1e-10 in the gradient."""
ZERO_ROW = 1e-150
"""A row shorter than this in the norm of P⁻¹ is zero: its square underflows."""
MASK = 0xFFFFFF
"""An integer is taken with it so that the compiler knows that an index is not negative."""

# What a compiled solve answers when it is not the number of iterations.
NOT_FINITE, CROSSED, INFEASIBLE, UNDECIDED, DOUBTFUL = -1, -2, -3, -4, -5

F = TypeVar("F", bound=Callable[..., object])

# Sums may be reordered, so that they vectorise; NaN and infinities keep their meaning.
REORDER = {"reassoc", "contract", "nsz"}


def compiled(function: F) -> F:
    """Compile a function with Numba, to be called from other compiled functions."""
    return cast(F, njit(fastmath=REORDER, error_model="numpy")(function))


def njit_inlined(function: F) -> F:
    """Compile a small function with Numba, inlined into its callers."""
    return cast(F, njit(fastmath=REORDER, error_model="numpy", forceinline=True)(function))


def block_starts(n_pad: int, width: int) -> tuple[int, int, int, int, int, int]:
    """Return the first row of each of the six matrices that the solver's work array holds."""
    K = VECTORS
    P = K + n_pad
    H = P + n_pad
    J = H + width
    A = J + width
    return K, P, H, J, A, A + width - n_pad


starts = compiled(block_starts)
"""`block_starts` for compiled functions."""


@compiled
def row_width(S: Matrix) -> int:
    """Return the number of columns for constraint rows in the work array, padding included."""
    width: int = (S.shape[1] - TAIL) & MASK
    return width


def code_checksum(function: Callable[..., object]) -> int:
    """Return a checksum of a function and all compiled functions that it calls: code, constants."""
    # Numba's cache looks at the file of the function it holds, not at what that function calls; a
    # checksum in its closure makes it look at both. What else has been imported is not in it:
    # another order of imports would compile all again.
    parts: list[tuple[CodeType, list[float]]] = []
    waiting, seen = [function], {function}
    while waiting:
        called = waiting.pop()
        assert isinstance(called, FunctionType)
        known = called.__globals__
        named = [known[name] for name in _referenced_names(called.__code__) if name in known]
        parts.append((called.__code__, [x for x in named if isinstance(x, (int, float))]))
        compiled_ones = {x.py_func: None for x in named if hasattr(x, "py_func")}
        waiting += [x for x in compiled_ones if x not in seen]
        seen.update(compiled_ones)
    # Version 2: later ones also write how often an object is referred to, which changes by itself.
    return zlib.crc32(marshal.dumps(parts, 2))


def _referenced_names(code: CodeType) -> list[str]:
    """List the names that a code object, and those nested in it, refer to."""
    inside = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return [*code.co_names, *(name for within in inside for name in _referenced_names(within))]


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
def mark_row_spans(S: Matrix, first: int, end: int, step: int, n: int) -> None:
    """Store which column ranges of work array rows are not zero, for products that skip zeros."""
    width = row_width(S)
    for r in range(first, end, step):
        count = 0
        for half in range(2):
            start, stop = (0, n) if half == 0 else (n, width)
            least, most = count, SPANS_BEFORE if half == 0 else SPANS
            for c in range(start, stop, LANES):
                if not has_nonzero_entry(S, r, r + step, c):
                    continue
                ahead = width + 2 * count + 1
                if count > least and (count == most or c - S[r, ahead] < GAP):
                    S[r, ahead] = c + LANES
                else:
                    S[r, ahead + 1], S[r, ahead + 2] = c, c + LANES
                    count += 1
            S[r, width + half] = count


@compiled
def mark_all_spans(S: Matrix, K: int, P: int, H: int, J: int, n: int) -> None:
    """Store which column ranges of −P⁻¹Cᵀ, [P Aᵀ] and C P⁻¹Cᵀ are not zero, to skip zeros."""
    mark_row_spans(S, K, P, GROUP, n)
    mark_row_spans(S, P, H, GROUP, n)
    mark_row_spans(S, H, J, 1, n)


@compiled
def has_nonzero_entry(S: Matrix, first: int, end: int, column: int) -> bool:
    """Return whether rows have a nonzero in the eight columns from `column` on."""
    for r in range(first, end):
        for c in range(column, column + LANES):
            if S[r, c] != 0.0:
                return True
    return False


@compiled
def part_spans(S: Matrix, r: int, width: int, part: int) -> tuple[int, int]:
    """Return in which columns a row's nonzero ranges are stored, for bounds, rows of A or both."""
    first = int(S[r, width]) if part == ROWS else 0
    end = int(S[r, width]) if part == BOUNDS else int(S[r, width + 1])
    return (width + 2 + 2 * first) & MASK, (width + 2 + 2 * end) & MASK


@compiled
def add_product(S: Matrix, out: int, first: int, by: int, n: int, part: int) -> None:
    """Add a matrix-vector product, zeros skipped, to a row of the work array."""
    width = row_width(S)
    for j in range(0, n, GROUP):
        a, b, c, d = S[by, j], S[by, j + 1], S[by, j + 2], S[by, j + 3]
        r = first + j
        if width <= NARROW:
            for i in range(n if part == ROWS else 0, n if part == BOUNDS else width):
                S[out, i] += a * S[r, i] + b * S[r + 1, i] + c * S[r + 2, i] + d * S[r + 3, i]
            continue
        span, end = part_spans(S, r, width, part)
        while span < end:
            for i in range(int(S[r, span]) & MASK, int(S[r, span + 1]) & MASK):
                S[out, i] += a * S[r, i] + b * S[r + 1, i] + c * S[r + 2, i] + d * S[r + 3, i]
            span += 2


@njit_inlined
def add_scaled_row(S: Matrix, out: int, a: float, r: int, part: int) -> None:
    """Add a times row r of C P⁻¹Cᵀ to a row of the work array, for bounds, rows of A or both."""
    width = row_width(S)
    if width <= NARROW:
        n = int(S[HEAD, N_PAD]) & MASK
        for i in range(n if part == ROWS else 0, n if part == BOUNDS else width):
            S[out, i] += a * S[r, i]
        return
    span, end = part_spans(S, r, width, part)
    while span < end:
        for i in range(int(S[r, span]) & MASK, int(S[r, span + 1]) & MASK):
            S[out, i] += a * S[r, i]
        span += 2
