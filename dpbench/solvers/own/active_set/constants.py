"""State of the compiled active-set method from step to step, in one array S.

With P = L Lᵀ, C = [I; A] and J = L⁻¹ Cᵀ,

    K = −P⁻¹ Cᵀ = −L⁻ᵀ J,   H = C P⁻¹ Cᵀ = JᵀJ                                      (eq. 31, 32)

`layout` shows what stands where in S. Lengths are padded to `LANES` and rows begin on a cache line,
without which the compiled loops take twice as long.
"""

import itertools

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import QuadraticProgram, rows_per_block
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.kernel import mark_spans

LANES = 16
LINE_BYTES = 64
# A guard against rounding only: the method ends by itself, usually within n + m iterations.
ITERATIONS_PER_ROW = 20


def _pad_length(length: int) -> int:
    """Return a length rounded up to a multiple of 16."""
    return -(-length // LANES) * LANES


def _allocate_aligned(rows: int, columns: int) -> Matrix:
    """Return a zero matrix whose memory begins on a cache line."""
    raw = np.zeros(rows * columns + LINE_BYTES // 8)
    start = -raw.ctypes.data % LINE_BYTES // 8
    return raw[start : start + rows * columns].reshape(rows, columns)


def new_problem_array(n: int, m: int) -> Matrix:
    """Allocate the work array of dpbench's compiled solvers, for n variables and m rows."""
    n_pad, m_pad = _pad_length(n), _pad_length(m)
    width = n_pad + m_pad
    L = layout.block_starts(n_pad, width)[-1]
    S = _allocate_aligned(L + n_pad, width + layout.TAIL)
    head = S[layout.HEAD]
    head[layout.N], head[layout.N_PAD], head[layout.M] = n, n_pad, m
    head[layout.LIMIT] = ITERATIONS_PER_ROW * (n + m)
    return S


def write_problem(S: Matrix, qp: QuadraticProgram, *, keep: bool) -> str:
    """Write `qp` and factors of P into the work array; return "" or why it cannot be solved.

    Parameters
    ----------
    S : of `new_problem_array(qp.n, qp.m)`, or filled before.
    keep : whether a solve starts from the active set of the one before, moved on by `qp.block`.
    """
    n, m = qp.n, qp.m
    n_pad, width = _pad_length(n), S.shape[1] - layout.TAIL
    rows = slice(n_pad, n_pad + m)
    if not (np.isfinite(qp.P).all() and np.isfinite(qp.A).all()):
        return "P or A is not finite"
    P = 0.5 * (qp.P + qp.P.T)
    try:
        L = np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        return "P is not positive definite"
    Ct = np.zeros((n, width))
    Ct[:, :n], Ct[:, rows] = np.eye(n), qp.A.T
    J = scipy.linalg.solve_triangular(L, Ct, lower=True, check_finite=False)
    K, PA, H, Jt, A = _block_views(S, n_pad)
    K[:n] = -scipy.linalg.solve_triangular(L, J, lower=True, trans="T", check_finite=False)
    PA[:n, :n], PA[:n, rows] = P, qp.A.T
    H[:] = J.T @ J
    mark_spans(S)
    S[layout.SUM, :width] = np.abs(PA).sum(axis=0)
    Jt[:, :n], A[:m, :n] = J.T, qp.A
    S[layout.UNIT, :width] = _inverse_row_lengths(H, n, rows)
    S[layout.LOW], S[layout.HIGH] = -np.inf, np.inf
    S[layout.LOW, :n], S[layout.HIGH, :n] = qp.lb, qp.ub
    S[layout.LOW, rows], S[layout.HIGH, rows], S[layout.Q, :n] = qp.l, qp.u, qp.q
    head = S[layout.HEAD]
    head[layout.KEEP], head[layout.STALE] = keep, 1
    head[layout.BLOCK], head[layout.BLOCK_ROWS] = qp.block, rows_per_block(n, m, qp.block)
    check = S[layout.CHECK]
    check[layout.LONGEST] = np.sqrt(H.diagonal().max())
    check[layout.STEEPEST] = np.sqrt(np.trace(P))
    check[layout.MOST] = layout.MOST_MULTIPLIER / max(np.abs(qp.A).max(initial=0.0), 1.0)
    return ""


def _block_views(S: Matrix, n_pad: int) -> tuple[Matrix, ...]:
    """Return five matrices in the work array as views: −P⁻¹Cᵀ, [P Aᵀ], C P⁻¹Cᵀ, its factor, A."""
    width = S.shape[1] - layout.TAIL
    firsts = layout.block_starts(n_pad, width)
    return tuple(S[first:end, :width] for first, end in itertools.pairwise(firsts))


def _inverse_row_lengths(H: Matrix, n: int, rows: slice) -> Vector:
    """Return 1 / P⁻¹-norm of each constraint row; 1 for zero rows, 0 for padding."""
    length = np.sqrt(H.diagonal())
    unit = np.ones(length.size)
    np.divide(1.0, length, out=unit, where=length > layout.ZERO_ROW)
    unit[n : rows.start] = 0.0
    unit[rows.stop :] = 0.0
    return unit


def result_views(S: Matrix, n: int, m: int) -> tuple[Vector, Vector, Vector]:
    """Return the answer z and multipliers y, y_box as views of the solver's work array."""
    n_pad = _pad_length(n)
    return S[layout.Z, :n], S[layout.LAM, n_pad : n_pad + m], S[layout.LAM, :n]


def vector_views(S: Matrix, n: int, m: int) -> tuple[Vector, Vector, Vector]:
    """Return linear cost q and row limits l, u as views of the solver's work array."""
    n_pad = _pad_length(n)
    rows = slice(n_pad, n_pad + m)
    return S[layout.Q, :n], S[layout.LOW, rows], S[layout.HIGH, rows]


def constraint_views(S: Matrix, n: int, m: int) -> tuple[Matrix, Vector, Vector, Vector, Vector]:
    """Return A (m, n), row limits l, u and bounds lb, ub as views of the solver's work array."""
    A = _block_views(S, _pad_length(n))[-1][:m, :n]
    return A, *vector_views(S, n, m)[1:], S[layout.LOW, :n], S[layout.HIGH, :n]
