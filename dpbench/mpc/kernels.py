"""Compiled kernels of condensing: the recursions of `condense.py` as loops.

At 30/5 the algebra is a few thousand multiply-adds; as array expressions it costs twenty times
that in calls. All arrays are C-contiguous float64; blocks are counted from 0 here.

    h  (N_p, n_y, n_u)    h[t] = C A^t B                         F  (N_p·n_y, n_x)   F_t = C A^{t+1}

    Φ (never formed)   move  0       1       …  N_c−1      E  (N_c·n_u, N_c·n_u) in blocks n_u
    instant    0             h0      0                        E_00   E_01   …
               1             h1      h0                       E_10   E_11   …
               …             …       …                        …             …
               N_p−1         hN_p−1  hN_p−2  …                last row: sums over all instants;
                                                              E_ij: E_i+1,j+1 and one product

    Z  (n + 2m, n_x + n_y + n_u + 1)  x         y_ref        u_prev     1
        n rows    q                   F_x       F_held       F_u        0
        m rows    l                   0         0            −G         u_min
        m rows    u                   0         0            −G         u_max    in units of a step

By hand, with one state, input and output, A = 2, B = C = Q = R = 1, N_p = 3, N_c = 2: h = 1, 2, 4
and Φ has the columns (1, 2, 4) and (0, 1, 2), so that E = ΦᵀΦ + I = [22 10; 10 6]. The last row by
sums is 1·2 + 2·4 = 10 and 1 + 4 + 1 = 6; the corner is E_11 − 1 and one product, 4·4, and 1: 22.
F = (2, 4, 8), so F_x = ΦᵀF = (2 + 8 + 32, 4 + 16) and F_held = −Φᵀ(1, 1, 1) = (−7, −3).

>>> one = np.ones((1, 1))
>>> E, F_x, F_held, F, h = condense_model_and_weights(2 * one, one, one, one, one, 3, 2)
>>> h.ravel().tolist(), F.ravel().tolist()
([1.0, 2.0, 4.0], [2.0, 4.0, 8.0])
>>> E.tolist(), F_x.ravel().tolist(), F_held.ravel().tolist()
([[22.0, 10.0], [10.0, 6.0]], [42.0, 20.0], [-7.0, -3.0])
"""

# Compiled by numba, which infers the types.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

import numpy as np

from dpbench.kernel_cache import njit

TILE = 32  # Rows and columns of a tile of P: 8 kB, of which two fit the smallest cache


@njit(cache=True)
def write_matrix_product(X, Y, out):
    """Write the matrix product X Y into `out`."""
    for i in range(X.shape[0]):
        for j in range(Y.shape[1]):
            total = 0.0
            for k in range(X.shape[1]):
                total += X[i, k] * Y[k, j]
            out[i, j] = total


@njit(cache=True)
def write_prediction_blocks(A, B, C, F, h):
    """Write F_t = C A^{t+1} and the Markov parameters h_t = C A^t B, t = 0 … N_p − 1 (eq. 15)."""
    N_p, n_y = h.shape[0], h.shape[1]
    G = C.copy()
    for t in range(N_p):
        write_matrix_product(G, B, h[t])
        following = F[t * n_y : (t + 1) * n_y]
        write_matrix_product(G, A, following)
        G = following


@njit(cache=True)
def _add_transposed_product(left, right, out):
    """Add the matrix product leftᵀ right to out."""
    for a in range(left.shape[1]):
        for b in range(right.shape[1]):
            total = 0.0
            for k in range(left.shape[0]):
                total += left[k, a] * right[k, b]
            out[a, b] += total


@njit(cache=True)
def write_condensed_hessian(h, Q, R, N_c, E):
    """Write the Hessian E = Φᵀ Q̄ Φ + R̄ of the condensed QP (eq. 24), without forming Φ.

    Last block row by sums over the horizon, the others along the block diagonals,
    E_ij = E_{i+1,j+1} + h_{N_p−1−i}ᵀ Q h_{N_p−1−j}: the work grows like the output.
    """
    N_p, n_y, n_u = h.shape
    Qh = np.empty_like(h)
    for t in range(N_p):
        write_matrix_product(Q, h[t], Qh[t])
    E[:] = 0.0
    last = N_c - 1
    for j in range(N_c):
        block = E[last * n_u :, j * n_u : (j + 1) * n_u]
        for t in range(N_p - last):
            _add_transposed_product(h[t], Qh[t + last - j], block)
    # Q h_{N_p−1−j} of all j side by side, so that a row of E is made in one sweep.
    beside = np.empty((n_y, N_c * n_u))
    for j in range(N_c):
        for k in range(n_y):
            for a in range(n_u):
                beside[k, j * n_u + a] = Qh[N_p - 1 - j, k, a]
    part = np.empty(N_c * n_u)
    for row in range(last * n_u - 1, -1, -1):
        i, a = row // n_u, row % n_u
        width = (i + 1) * n_u
        part[:width] = 0.0
        for k in range(n_y):
            weight = h[N_p - 1 - i, k, a]
            for c in range(width):
                part[c] += weight * beside[k, c]
        for c in range(width):
            E[row, c] = E[row + n_u, c + n_u] + part[c]
    for i in range(N_c):
        for a in range(n_u):
            for b in range(n_u):
                E[i * n_u + a, i * n_u + b] += R[a, b]
    _copy_lower_triangle_to_upper(E)


@njit(cache=True)
def _copy_lower_triangle_to_upper(E):
    """Copy the lower triangle of a square matrix to the upper one, tile by tile for cache speed."""
    n = E.shape[0]
    for top in range(0, n, TILE):
        for left in range(0, top + 1, TILE):
            for a in range(top, min(top + TILE, n)):
                for b in range(left, min(left + TILE, a)):
                    E[b, a] = E[a, b]


@njit(cache=True)
def write_condensed_gradient_maps(h, F, Q, F_x, F_held):
    """Write the maps from state (F_x) and constant reference (F_held) to the condensed gradient."""
    N_p, n_y, n_u = h.shape
    QF = np.empty_like(F)
    for t in range(N_p):
        write_matrix_product(Q, F[t * n_y : (t + 1) * n_y], QF[t * n_y : (t + 1) * n_y])
    F_x[:] = 0.0
    N_c, n_x = F_x.shape[0] // n_u, F_x.shape[1]
    part = np.empty(n_x)
    for j in range(N_c):
        for t in range(N_p - j):
            for a in range(n_u):
                # The states innermost, as in memory: most of the time is spent here.
                part[:] = 0.0
                for k in range(n_y):
                    weight = h[t, k, a]
                    for b in range(n_x):
                        part[b] += weight * QF[(t + j) * n_y + k, b]
                for b in range(n_x):
                    F_x[j * n_u + a, b] += part[b]
    # A reference that is held meets each h_t in all moves up to N_p − t: one sum that goes on.
    held = np.zeros((n_u, n_y))
    for t in range(N_p):
        _add_transposed_product(h[t], Q, held)
        j = N_p - 1 - t
        if j < N_c:
            for a in range(n_u):
                for b in range(n_y):
                    F_held[j * n_u + a, b] = -held[a, b]


@njit(cache=True)
def condense_model_and_weights(A, B, C, Q, R, N_p, N_c):
    """Condense an MPC problem: return Hessian, gradient maps, free response, Markov parameters."""
    n_x, n_u, n_y = A.shape[0], B.shape[1], C.shape[0]
    F = np.empty((N_p * n_y, n_x))
    h = np.empty((N_p, n_y, n_u))
    E = np.empty((N_c * n_u, N_c * n_u))
    F_x = np.empty((N_c * n_u, n_x))
    F_held = np.empty((N_c * n_u, n_y))
    write_prediction_blocks(A, B, C, F, h)
    write_condensed_hessian(h, Q, R, N_c, E)
    write_condensed_gradient_maps(h, F, Q, F_x, F_held)
    return E, F_x, F_held, F, h


@njit(cache=True)
def write_rows_of_summed_increments(G, rows):
    """Write the matrix to `rows` that maps increments to G times their sum up to each move."""
    r, n_u = G.shape
    n = rows.shape[1]
    all_moves = np.empty((r, n))
    for k in range(r):
        for c in range(n):
            all_moves[k, c] = G[k, c % n_u]
    for i in range(n // n_u):
        end = (i + 1) * n_u
        for k in range(r):
            for c in range(end):
                rows[i * r + k, c] = all_moves[k, c]
            for c in range(end, n):
                rows[i * r + k, c] = 0.0 * all_moves[k, c]


@njit(cache=True, error_model="numpy")
def write_limits_reachable_at_rate(u_prev, u_min, u_max, row_max, row_unit, l, u, N_c):  # noqa: E741 - of l ≤ Az ≤ u
    """Write each move's amplitude limits, extended as far as the rate limit requires, into l and u.

    In maximum increments the reachable bounds −i and i are exact, so a row that is forced to its
    bound meets it to the last bit and no rounding makes the step infeasible.
    """
    r, stride = len(u_prev), len(l) // N_c
    for i in range(N_c):
        for k in range(r):
            low, high = (u_min[k] - u_prev[k]) / row_max[k], (u_max[k] - u_prev[k]) / row_max[k]
            low = i + 1.0 if low > i + 1.0 else low
            high = -(i + 1.0) if high < -(i + 1.0) else high
            l[i * stride + k], u[i * stride + k] = low * row_unit[k], high * row_unit[k]


@njit(cache=True)
def build_affine_map_from_blocks(F_x, F_held, F_u, G, u_min, u_max, unit, row_unit):
    """Return Z from [x; y_ref; u_prev; 1] to [q; l; u] (eq. 20-24), in units of z and of rows."""
    n, n_x, n_y = F_x.shape[0], F_x.shape[1], F_held.shape[1]
    r, n_u = G.shape
    N_c = n // n_u
    first, one = n_x + n_y, n_x + n_y + n_u
    Z = np.zeros((n + 2 * N_c * r, one + 1))
    for a in range(n):
        scale = unit[a % n_u]
        for b in range(n_x):
            Z[a, b] = scale * F_x[a, b]
        for b in range(n_y):
            Z[a, n_x + b] = scale * F_held[a, b]
        for b in range(F_u.shape[1]):
            Z[a, first + b] = scale * F_u[a, b]
    for a in range(N_c * r):
        i = a % r
        for top, limit in ((n, u_min), (n + N_c * r, u_max)):
            for b in range(n_u):
                if G[i, b] != 0.0:
                    Z[top + a, first + b] = -G[i, b] / row_unit[i]
            Z[top + a, one] = limit[i] / row_unit[i]
    return Z
