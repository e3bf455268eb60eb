"""Compiled kernels of condensing: the recursions of `prediction.py` and `condense.py` as loops.

At 30/5 the algebra is a few thousand multiply-adds; as array expressions it costs twenty times
that in calls. All arrays are C-contiguous float64; blocks are counted from 0 here.
"""

# The functions are compiled by numba, which infers their types.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def product(X, Y, out):
    """out = X Y."""
    for i in range(X.shape[0]):
        for j in range(Y.shape[1]):
            total = 0.0
            for k in range(X.shape[1]):
                total += X[i, k] * Y[k, j]
            out[i, j] = total


@njit(cache=True)
def markov_blocks(A, B, C, F, h):
    """F_t = C A^{t+1} and h_t = C A^t B by G_{t+1} = G_t A (eq. 15)."""
    N_p, n_y = h.shape[0], h.shape[1]
    G = C.copy()
    for t in range(N_p):
        product(G, B, h[t])
        following = F[t * n_y : (t + 1) * n_y]
        product(G, A, following)
        G = following


@njit(cache=True)
def _accumulate(left, right, out):
    """out += leftᵀ right."""
    for a in range(left.shape[1]):
        for b in range(right.shape[1]):
            total = 0.0
            for k in range(left.shape[0]):
                total += left[k, a] * right[k, b]
            out[a, b] += total


@njit(cache=True)
def hessian_blocks(h, Q, R, N_c, E):
    """E = Φᵀ Q̄ Φ + R̄ (eq. 24), symmetric to the last bit, without forming Φ.

    Last block row by sums over the horizon, the others along the block diagonals,
    E_ij = E_{i+1,j+1} + h_{N_p−1−i}ᵀ Q h_{N_p−1−j}: the work grows like the output.
    """
    N_p, _, n_u = h.shape
    Qh = np.empty_like(h)
    for t in range(N_p):
        product(Q, h[t], Qh[t])
    E[:] = 0.0
    last = N_c - 1
    for j in range(N_c):
        block = E[last * n_u :, j * n_u : (j + 1) * n_u]
        for t in range(N_p - last):
            _accumulate(h[t], Qh[t + last - j], block)
    for i in range(last - 1, -1, -1):
        for j in range(i + 1):
            block = E[i * n_u : (i + 1) * n_u, j * n_u : (j + 1) * n_u]
            block[:] = E[(i + 1) * n_u : (i + 2) * n_u, (j + 1) * n_u : (j + 2) * n_u]
            _accumulate(h[N_p - 1 - i], Qh[N_p - 1 - j], block)
    for i in range(N_c):
        E[i * n_u : (i + 1) * n_u, i * n_u : (i + 1) * n_u] += R
    for a in range(E.shape[0]):
        for b in range(a):
            E[b, a] = E[a, b]


@njit(cache=True)
def gradient_blocks(h, F, Q, F_x, F_held):
    """F_x = Φᵀ Q̄ F and F_held = −Φᵀ Q̄ D (eq. 24), D stacking N_p identities (eq. 16)."""
    N_p, n_y, n_u = h.shape
    QF = np.empty_like(F)
    for t in range(N_p):
        product(Q, F[t * n_y : (t + 1) * n_y], QF[t * n_y : (t + 1) * n_y])
    F_x[:] = 0.0
    F_held[:] = 0.0
    for j in range(F_x.shape[0] // n_u):
        rows = F_x[j * n_u : (j + 1) * n_u]
        held = F_held[j * n_u : (j + 1) * n_u]
        for t in range(N_p - j):
            _accumulate(h[t], QF[(t + j) * n_y : (t + j + 1) * n_y], rows)
            _accumulate(h[t], Q, held)
    for a in range(F_held.shape[0]):
        for b in range(n_y):
            F_held[a, b] = -F_held[a, b]


@njit(cache=True)
def condense_blocks(A, B, C, Q, R, N_p, N_c):
    """Everything constant in eq. 15-24: E, F_x, F_held, F, h."""
    n_x, n_u, n_y = A.shape[0], B.shape[1], C.shape[0]
    F = np.empty((N_p * n_y, n_x))
    h = np.empty((N_p, n_y, n_u))
    E = np.empty((N_c * n_u, N_c * n_u))
    F_x = np.empty((N_c * n_u, n_x))
    F_held = np.empty((N_c * n_u, n_y))
    markov_blocks(A, B, C, F, h)
    hessian_blocks(h, Q, R, N_c, E)
    gradient_blocks(h, F, Q, F_x, F_held)
    return E, F_x, F_held, F, h


@njit(cache=True)
def map_blocks(F_x, F_held, u_min, u_max, unit):
    """Z (3n, n_x + n_y + n_u + 1) with [q; l; u] = Z [x; y_ref; u_prev; 1] (eq. 20-24).

    `unit` (n_u,) is the force that one unit of z and of a row stands for.
    """
    n, n_x, n_y, n_u = F_x.shape[0], F_x.shape[1], F_held.shape[1], len(unit)
    Z = np.zeros((3 * n, n_x + n_y + n_u + 1))
    for a in range(n):
        i = a % n_u
        for b in range(n_x):
            Z[a, b] = unit[i] * F_x[a, b]
        for b in range(n_y):
            Z[a, n_x + b] = unit[i] * F_held[a, b]
        for top, limit in ((n, u_min), (2 * n, u_max)):
            Z[top + a, n_x + n_y + i] = -1.0 / unit[i]
            Z[top + a, n_x + n_y + n_u] = limit[i] / unit[i]
    return Z
