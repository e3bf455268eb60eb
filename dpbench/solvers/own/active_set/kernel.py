"""The paper's active-set method (eq. 30-32) compiled: one call per step.

The set of the step before is tried as it is. If it is not optimal it is moved on by one move with
its multipliers, and these are moved to what eq. 31 asks for; a row whose multiplier reaches zero on
the way is dropped. From that dual feasible set the rule of Goldfarb and Idnani goes on: the most
violated row is brought in, and rows whose multiplier reaches zero on the way are dropped
(`qp/dual_active_set.py` says why that ends for any such start). What rounding does not let it tell
is answered `UNDECIDED`. The answer is then refined in the problem's own data,

    P δz + C_Wᵀ δλ = −(P z + q + Cᵀλ),   C_W δz = g − C_W z,

until a correction is rounding, or the next one would be. It is checked against every row again if
it is not at once; in full (`check`) where rounding of large multipliers or of a long plan may show;
and where more rows meet than are active, whether rounding moves the point (`start`). `layout` shows
the array S that all of it works on, and what its indices mean.

An example to follow by hand: the point nearest (3, 3) under z₁ ≤ 1, z₂ ≤ 1 and z₁ + z₂ ≤ 2.5, that
is P = I and q = (−3, −3). Bounds are rows 0 and 1 of C, the row of A is row 16 as n is padded to
16. H holds the products of the rows: 1 for a bound with itself, 1 for a bound with the row of A, 2
for that row with itself.

     what happens                                          λ₀    λ₁    λ₁₆    z
     start: q alone; violated, in lengths of the rows,                        (3, 3)
       are the bounds by 2 each, row 16 by 3.5/√2 = 2.47
     1 row 16 comes in: λ₁₆ = 3.5/H = 3.5/2                            1.75   (1.25, 1.25)
     2 row 0, the first of two violated by 0.25: of it
       ½ lies along row 16, so that 1 − ½·1 = ½ of its
       length² is its own; λ₀ = 0.25/½, λ₁₆ −= ½·λ₀        0.5         1.5    (1, 1.5)
     3 row 1, violated by 0.5, is row 16 less row 0: no
       step along z; as λ₁ grows, λ₁₆ falls and λ₀ grows
       alike. At 1.5 λ₁₆ is zero and row 16 is dropped     2.0   (1.5) 0      (1, 1.5)
     4 row 1 at last is free of row 0: λ₁ += 0.5/1         2.0   2.0          (1, 1)

The slope there is z − (3, 3) + (λ₀, λ₁) = 0 with both λ ≥ 0: the optimum. Allowed fewer iterations,
the method stops where the table does:

>>> import numpy as np
>>> from dpbench.qp.program import QuadraticProgram
>>> from dpbench.solvers.own.active_set.constants import new_problem_array, write_problem
>>> from dpbench.solvers.own.active_set.layout import ACTIVE, LAM, LIMIT, Z
>>> upper = np.ones(2)
>>> nearest = np.eye(2), [-3, -3], [[1, 1]], [-10], [2.5], -10 * upper, upper
>>> S = new_problem_array(n=2, m=1)
>>> write_problem(S, QuadraticProgram(*nearest), keep=False)
''
>>> def multipliers_after(iterations):
...     S[HEAD, LIMIT] = iterations
...     solve_step(S)
...     active = S[ACTIVE, : int(S[HEAD, COUNT])].astype(int)
...     return {int(i): round(float(S[LAM, i]), 12) for i in active}
>>> multipliers_after(1)
{16: 1.75}
>>> multipliers_after(2)
{16: 1.5, 0: 0.5}
>>> multipliers_after(3)
{0: 2.0}
>>> multipliers_after(4)
{0: 2.0, 1: 2.0}
>>> solve_step(S), S[Z, :2].round(12).tolist()
(4, [1.0, 1.0])
"""

from collections.abc import Callable
from math import inf, sqrt
from typing import Any

from dpbench.arrays import Matrix
from dpbench.kernel_cache import njit
from dpbench.solvers.own.active_set.check import (
    correct_wrong_signs,
    is_clearly_optimal,
    is_near_optimum,
    is_refinement_settled,
    largest_excess,
    refine_answer,
)
from dpbench.solvers.own.active_set.factor import (
    DEPENDENT,
    VIOLATED,
    append_active_row,
    apply_row_changes,
    choose_next_row,
    compute_values_on_set,
    drop_active_row,
    find_most_violated,
    list_candidates,
    recompute_values,
    solve_direction,
)
from dpbench.solvers.own.active_set.layout import (
    ACTIVE,
    ASIDE,
    CHECK,
    COUNT,
    DOUBTFUL,
    HEAD,
    HIGH,
    INFEASIBLE,
    ITERATIONS,
    KEEP,
    LAM,
    LENGTH,
    LIMIT,
    LOW,
    MASK,
    N_PAD,
    NARROW,
    PUT_ASIDE,
    REORDER,
    SIDE,
    STALE,
    STAMP,
    STEP,
    UNDECIDED,
    UNIT,
    V0,
    WORST,
    M,
    N,
    Q,
    R,
    V,
    code_checksum,
    compiled,
    mark_all_spans,
    row_width,
    starts,
)
from dpbench.solvers.own.active_set.start import (
    choose_start,
    compute_unconstrained_values,
    is_degenerate_vertex,
    norm_of_values,
    refactorise_active_set,
    restore_dual_feasibility,
)

UNCLEAR = 1e-7
"""Between `DEPENDENT` and this share of its length it cannot be told here whether a row is a
combination of the active ones."""
NO_PART = 1e-11
"""A row whose share in a combination is less has none: without a row to bring in, nothing but a
multiplier's way to zero ends a step, and on a share that is rounding that way has no end."""
GROSS = 1e-4
"""Share of the sizes that meet there by which values that are not refined cannot be wrong."""
CONTRADICTION = 1e-9
"""A violated dependent row is taken for a contradiction if violated by more than this share."""
PASSES = 20
"""Rounds of refinement after which it has not settled."""
TINY = 1e-300
"""In place of a squared length of zero."""


@compiled
def write_farkas_ray(S: Matrix, j: int, side: float, w: int) -> int:
    """Replace the multipliers by a Farkas ray: proof that row j contradicts the active rows."""
    for i in range(row_width(S)):
        S[LAM, i] = 0.0
    for k in range(w):
        S[LAM, int(S[ACTIVE, k]) & MASK] = -side * S[R, k]
    S[LAM, j] = side
    return INFEASIBLE


@compiled
def set_duplicate_aside(S: Matrix, H: int, j: int, lam: float) -> int:
    """Exclude row j, a combination of active rows; keep its multiplier's effect on row values."""
    S[SIDE, j], S[LAM, j] = PUT_ASIDE, lam
    S[HEAD, ASIDE] += 1
    for i in range(row_width(S)):
        S[V0, i] -= lam * S[H + j, i]
    return 0


@compiled
def find_blocking_row(S: Matrix, j: int, side: float, w: int, dependent: bool) -> tuple[int, float]:
    """Find the active row whose multiplier is first to reach zero as row j's rises; −1 if none."""
    blocking, t_dual = -1, inf
    for k in range(w):
        i, a = int(S[ACTIVE, k]) & MASK, side * S[R, k]
        nothing = dependent and abs(a) * S[UNIT, j] < NO_PART * S[UNIT, i]
        if a * S[SIDE, i] > 0.0 and S[LOW, i] < S[HIGH, i] and not nothing:
            t = max(S[LAM, i] / a, 0.0)
            if t < t_dual:
                blocking, t_dual = k, t
    return blocking, t_dual


@compiled
def activate_row(S: Matrix, L: int, H: int, J: int, j: int, size: float) -> int:
    """Raise the multiplier of violated row j until it meets its limit; drop rows that block.

    A dependent row that nothing blocks is a contradiction, or the active rows written twice; with
    an infinite `size`, before values are refined, it is the former only where that is `GROSS`.
    """
    n = int(S[HEAD, N]) & MASK
    side = 1.0 if S[V, j] > S[HIGH, j] else -1.0
    g = S[HIGH, j] if side > 0.0 else S[LOW, j]
    gap, lam = side * (S[V, j] - g), S[LAM, j]
    while S[HEAD, ITERATIONS] < S[HEAD, LIMIT]:
        S[HEAD, ITERATIONS] += 1
        w = int(S[HEAD, COUNT]) & MASK
        d = solve_direction(S, L, H, J, j, int(S[HEAD, N_PAD]) & MASK, w)
        dependent = w == n or d <= DEPENDENT * DEPENDENT * S[H + j, j]
        if not dependent and d < UNCLEAR * UNCLEAR * S[H + j, j]:
            return UNDECIDED
        blocking, t_dual = find_blocking_row(S, j, side, w, dependent)
        if dependent and blocking < 0:
            least = CONTRADICTION * (abs(g) * S[UNIT, j] + size)
            if size == inf:
                least = GROSS * (abs(g) * S[UNIT, j] + S[CHECK, LENGTH] + norm_of_values(S, V))
            if gap * S[UNIT, j] > least:
                return write_farkas_ray(S, j, side, w)
            return set_duplicate_aside(S, H, j, lam)
        t_primal = inf if dependent else gap / d
        t = min(t_primal, t_dual)
        for k in range(w):
            S[LAM, int(S[ACTIVE, k]) & MASK] -= t * side * S[R, k]
        lam += t * side
        if t_primal <= t_dual:
            for k in range(w):
                S[L + w, k] = S[STEP, k]
            S[LAM, j] = lam
            append_active_row(S, L, w, j, side, d)
            return 0
        if not dependent:
            gap -= t * d
        drop_active_row(S, L, blocking, w)
    return UNDECIDED


@compiled
def readmit_row(S: Matrix, H: int, size: float) -> int:
    """Readmit the excluded dependent row that is violated most; return its number, −1 if none."""
    most, row = 1.0, -1
    for i in range(row_width(S)):
        if S[SIDE, i] == PUT_ASIDE:
            over, under = S[V, i] - S[HIGH, i], S[LOW, i] - S[V, i]
            e, g = (over, S[HIGH, i]) if over >= under else (under, S[LOW, i])
            share = e * S[UNIT, i] / (CONTRADICTION * (abs(g) * S[UNIT, i] + size))
            if share > most:
                most, row = share, i
    if row >= 0:
        S[SIDE, row] = 0.0
        S[HEAD, ASIDE] -= 1
        for i in range(row_width(S)):
            S[V0, i] += S[LAM, row] * S[H + row, i]
    return row


@compiled
def activate_violated_rows(
    S: Matrix, L: int, H: int, J: int, j: int, coarse: float, size: float
) -> int:
    """Activate row j, then violated rows until none is left; return 0, or a code < 0 on failure."""
    if j >= 0 and row_width(S) > NARROW:
        list_candidates(S, j, coarse)
    while j >= 0:
        ending = activate_row(S, L, H, J, j, size)
        if ending != 0:
            return ending
        j = choose_next_row(S, H, coarse)
    return 0


@compiled
def find_violated_row(
    S: Matrix, P: int, L: int, H: int, noise: float, size: float, dropped: int
) -> int:
    """Find a row that the refined answer violates, excluded dependent rows last; −1 if none."""
    recompute_values(S, P, H)
    if dropped > 0:
        restore_dual_feasibility(S, L)
        compute_values_on_set(S, H)
    j = find_most_violated(S, noise)
    return readmit_row(S, H, size) if j < 0 and S[HEAD, ASIDE] > 0.0 else j


@compiled
def accept_or_doubt(S: Matrix, P: int, H: int, J: int, L: int, size: float, clear: bool) -> int:
    """Return the iterations of an optimal answer, or `DOUBTFUL` where rounding may decide it."""
    if is_degenerate_vertex(S, L, H, J, size):
        return DOUBTFUL
    n, alone = int(S[HEAD, N_PAD]) & MASK, S[HEAD, ASIDE] == 0.0
    near = clear or (alone and is_near_optimum(S, P, H, n, row_width(S)))
    return int(S[HEAD, ITERATIONS]) if near else DOUBTFUL


@compiled
def solve_qp(S: Matrix) -> int:
    """Solve the QP in the work array; return the number of iterations, or a failure code < 0."""
    n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
    K, P, H, J, A, L = starts(n, width)
    size = compute_unconstrained_values(S, K)
    if size < 0.0:
        return int(size)
    coarse, first = VIOLATED * size, max(size * size, TINY)
    j, before = choose_start(S, L, H, coarse), first
    # Whether rows hardly contradict each other is decided on refined values only.
    size = inf
    for _ in range(PASSES):
        ending = activate_violated_rows(S, L, H, J, j, coarse, size)
        if ending != 0:
            return ending
        correction = refine_answer(S, K, P, H, A, L)
        dropped = correct_wrong_signs(S, L, max(coarse, sqrt(correction)))
        size = norm_of_values(S, V)
        settled = dropped == 0 and is_refinement_settled(correction, before, size)
        if settled and is_clearly_optimal(S, P, coarse, size, correction):
            return accept_or_doubt(S, P, H, J, L, size, True)
        j = find_violated_row(S, P, L, H, max(VIOLATED * size, sqrt(correction)), size, dropped)
        # No longer falling: the correction is the rounding of this problem.
        falling = correction <= 0.25 * before
        if j < 0 and (settled or (dropped == 0 and not falling)):
            if largest_excess(S, P, n, width) <= 1.0:
                return accept_or_doubt(S, P, H, J, L, size, False)
            # What is left to do if it does not fall: a row that `VIOLATED` has let pass.
            j = -1 if falling else int(S[CHECK, WORST])
            if j < 0 and not falling:
                return UNDECIDED
        before = correction if j < 0 else first
    return UNDECIDED


def _compile_entry_points(version: int) -> tuple[Callable[..., Any], ...]:
    """Compile the active-set functions that Python calls, for fixed types, cached on disk."""

    @njit("i8(f8[:, ::1])", cache=True, fastmath=REORDER, error_model="numpy")
    def solve_step(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        ending = solve_qp(S)
        S[HEAD, STALE] = 1.0 if ending < 0 and ending != DOUBTFUL else 0.0
        return ending

    @njit("b1(f8[:, ::1], f8[::1], f8[::1], f8[::1])", cache=True)
    def write_vectors(S, q, low, high):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, n_pad, m = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, int(S[HEAD, M])
        if q.shape[0] != n or low.shape[0] != m or high.shape[0] != m:
            return False
        for i in range(n):
            S[Q, i] = q[i]
        for i in range(m):
            S[LOW, n_pad + i], S[HIGH, n_pad + i] = low[i], high[i]
        return True

    @njit("b1(f8[:, ::1], f8[:, ::1])", cache=True, fastmath=REORDER, error_model="numpy")
    def replace_row_matrix(S, A):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
        if A.shape[0] != S[HEAD, M] or A.shape[1] != S[HEAD, N]:
            return False
        K, P, H, J, rows, L = starts(n, width)
        ending = apply_row_changes(S, K, P, H, J, rows, A)
        if ending > 0:
            mark_all_spans(S, K, P, H, J, n)
        if ending >= 0 and S[HEAD, KEEP] > 0.0 and S[HEAD, STALE] == 0.0:
            refactorise_active_set(S, L, H)
        return ending >= 0

    @njit("f8(f8[:, ::1])", cache=True, fastmath=REORDER, error_model="numpy")
    def optimality_excess(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
        return largest_excess(S, starts(n, width)[1], n, width)

    @njit("void(f8[:, ::1])", cache=True, error_model="numpy")
    def mark_spans(S):  # type: ignore[no-untyped-def] # compiled by numba
        S[HEAD, STAMP] = version
        n, width = int(S[HEAD, N_PAD]) & MASK, row_width(S)
        K, P, H, J, _, _ = starts(n, width)
        mark_all_spans(S, K, P, H, J, n)

    # Without Numba's dispatcher, which takes 0.1 µs a call to find the type of S again.
    dispatcher: Any = solve_step
    step = dispatcher.get_overload(dispatcher.signatures[0])
    return step, write_vectors, replace_row_matrix, optimality_excess, mark_spans


solve_step, write_vectors, replace_row_matrix, optimality_excess, mark_spans = (
    _compile_entry_points(code_checksum(_compile_entry_points))
)
"""solve_step(S): solve the QP in S; return the number of iterations, or a negative ending.
write_vectors(S, q, l, u): copy the vectors into S; False where a length does not fit, TypeError for
anything but contiguous float64 vectors that may be written to.
replace_row_matrix(S, A): write A and all that is made of it, keep the active set; False where a
shape does not fit or `write_problem` has to make it; TypeError for anything but a contiguous
float64 matrix. The limits in S are to be those of the step already.
optimality_excess(S): ratio of the optimality residuals of z and λ in S to what is allowed.
mark_spans(S): write where the rows of K, [P Aᵀ] and H are not zero; after every change of them."""
