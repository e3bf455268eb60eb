"""Kernels of the linear certificate: a residual in twice the precision, and a proof by it.

    K (N, N)   ┌ P   C_Wᵀ ┐  n    x ┌ z   ┐    rhs ┌ −q  ┐    X ≈ K⁻¹, kept by columns: X_T[j] is
               └ C_W  0   ┘  w      └ λ_W ┘        └ b_W ┘    column j of X;  C_T[j] column j of C

K is symmetric, so that row j is its column j: all products go column by column, and the inner loop
runs over neighbours in memory whose sums do not wait for each other.

The residual b − Kx is Dot2 of Ogita, Rump and Oishi (Accurate sum and dot product, SIAM J. Sci.
Comput. 26, 2005, proposition 5.5): every product and sum is split without error into its float64
value and its rounding error (Dekker 1971; Knuth, TAOCP 2, 4.2.2), and these errors are summed too.
With u = 2⁻⁵³

    |r − (b − Kx)| ≤ u |b − Kx| + γ²_{N+1} (|b| + |K||x|)

The splitting must be calculated as written: no `fastmath`, which would cancel the errors to zero.
Numbers beyond 2⁹⁹⁶ overflow in it to NaN, and NaN proves nothing.

By hand, 1 − 3·x at the float64 number next to ⅓, x = ⅓ − 2⁻⁵⁴/3: 3x rounds to 1, so that float64
has no residual. The product's error is 3x − 1 = −2⁻⁵⁴, and the residual +2⁻⁵⁴:

>>> third, r = np.array([1 / 3]), np.empty(1)
>>> _write_residual_in_double_precision.py_func(np.array([[3.0]]), third, np.ones(1), r)
>>> float(1.0 - 3.0 * third[0]), float(r[0]) * 2**54
(0.0, 1.0)

For x this proves: X = ⅓ rounded finds x from zero, and its error is the residual over 3, 2⁻⁵⁴/3, to
within the rounding of the bound:

>>> K, X_T, ones = np.array([[3.0]]), np.array([[1 / 3]]), np.ones(1)
>>> x, error = np.zeros(1), np.zeros(1)
>>> _write_solution_and_error_bound.py_func(K, X_T, ones, 1e-15, 1e-15, ones, x, error)
>>> bool(x[0] == third[0]), round(float(error[0]) * 3 * 2**54, 9)
(True, 1.0)
"""

# Compiled by numba, which infers the types.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

import numpy as np

from dpbench.kernel_cache import njit

UNIT = float(np.finfo(np.float64).eps)  # Twice the unit roundoff, which leaves room
OUTWARD = 1.0 + 1e-11  # Covers the rounding of the bounds: sums of some 10⁴ positive terms
UNDERFLOW = 1e-291  # Far above what any sum here can lose by underflow
SPLITTER = 2.0**27 + 1.0  # Halves the 53 bits of a float64 (Veltkamp)
# Limits that may be certified; a lower one above its upper one; no numbers any z could satisfy.
ORDERED_LIMITS, CROSSED_LIMITS, INVALID_DATA = 0, 1, 2
# Divisions need no check for zero: what is not finite proves nothing.
inlined_njit = njit(error_model="numpy")
cached_njit = njit(cache=True, error_model="numpy")


@inlined_njit
def add_matrix_vector_product(columns, x, total):
    """Add the matrix-vector product Σ columns[j]·x[j] to total."""
    for j in range(len(x)):
        factor = x[j]
        for i in range(len(total)):
            total[i] += columns[j, i] * factor


@inlined_njit
def _add_absolute_matrix_vector_product(columns, x, total):
    """Add the product of absolute values Σ |columns[j]|·|x[j]| to total."""
    for j in range(len(x)):
        factor = abs(x[j])
        for i in range(len(total)):
            total[i] += abs(columns[j, i]) * factor


@inlined_njit
def _write_residual_in_double_precision(K, x, b, r):
    """Write r (N,) = b − K x of a symmetric K, in twice the working precision."""
    N = len(b)
    lost = np.zeros(N)
    for i in range(N):
        r[i] = b[i]
    for j in range(N):
        factor = -x[j]
        cut = SPLITTER * factor
        high = cut - (cut - factor)
        low = factor - high
        for i in range(N):
            number = K[j, i]
            product = number * factor
            cut = SPLITTER * number
            upper = cut - (cut - number)
            lower = number - upper
            rest = lower * low - (((product - upper * high) - lower * high) - upper * low)
            before = r[i]
            after = before + product
            taken = after - before
            lost[i] += ((before - (after - taken)) + (product - taken)) + rest
            r[i] = after
    for i in range(N):
        r[i] += lost[i]


@inlined_njit
def _write_solution_and_error_bound(K, X_T, weight, alpha, gamma, rhs, x, error):
    """Write x (N,) = K⁻¹ rhs and a rigorous bound of its error.

    By |K⁻¹b − x| ≤ e + α/(1−α) · max_i(e_i/d_i) · d,  e ≥ |X(b − Kx)|, as in `kkt`.
    """
    N = len(rhs)
    r, size, change = np.zeros(N), np.zeros(N), np.zeros(N)
    # From zero by X b, refined once: X(b − Kx) is added twice, each time in one piece so that x is
    # rounded once, and then bounded.
    for _ in range(3):
        for i in range(N):
            x[i] += change[i]
            change[i] = 0.0
        _write_residual_in_double_precision(K, x, rhs, r)
        add_matrix_vector_product(X_T, r, change)
    for i in range(N):
        size[i] = abs(rhs[i])
    _add_absolute_matrix_vector_product(K, x, size)
    # The rounding of r, of X r, and of r itself as a share of it.
    for i in range(N):
        size[i] = gamma * gamma * size[i] + gamma * abs(r[i]) + UNDERFLOW
    _add_absolute_matrix_vector_product(X_T, size, error)
    largest = 0.0
    for i in range(N):
        error[i] = (abs(change[i]) + error[i]) * OUTWARD
        largest = max(largest, error[i] / weight[i])
    spread = alpha / (1.0 - alpha) * largest * OUTWARD
    for i in range(N):
        error[i] += spread * weight[i]


@inlined_njit
def _are_all_finite(numbers):
    """Return whether all numbers are finite."""
    good = True
    for number in numbers:
        good &= np.isfinite(number)
    return good


@inlined_njit
def _is_active_set_beyond_doubt(L, U, rows, signs, lam, lam_doubt, value, doubt, held):
    """Return whether multipliers and slacks exceed their error bounds, so that their signs hold."""
    for k in range(len(rows)):
        i = rows[k]
        if L[i] != U[i] and not signs[k] * lam[k] > lam_doubt[k]:
            return False
    for i in range(len(value)):
        if not held[i] and not min(U[i] - value[i], value[i] - L[i]) > doubt[i]:
            return False
    return True


@cached_njit
def prove_active_set_optimal(q, L, U, C_T, gamma_C, K, X_T, weight, rows, signs, alpha, gamma_K):
    """Test whether the active set of a KKT system is proven optimal; compute point and bounds.

    Returns the bound of the error of z, inf where nothing is proven; x (n+w,) the point and its
    multipliers with bounds of their errors; y (N,) the multipliers row by row.
    """
    n, N, size = len(q), len(L), len(K)
    x, error, rhs = np.zeros(size), np.zeros(size), np.zeros(size)
    y, value, doubt = np.zeros(N), np.zeros(N), np.zeros(N)
    held = np.zeros(N, dtype=np.bool_)
    for i in range(n):
        rhs[i] = -q[i]
    for k in range(len(rows)):
        i = rows[k]
        held[i] = True
        rhs[n + k] = U[i] if signs[k] > 0.0 else L[i]
        if not np.isfinite(rhs[n + k]):
            return np.inf, x, error, y
    z, lam, z_error, lam_error = x[:n], x[n:], error[:n], error[n:]
    _write_solution_and_error_bound(K, X_T, weight, alpha, gamma_K, rhs, x, error)
    # Rounding of C z and of the final subtraction, and what z itself is uncertain by.
    add_matrix_vector_product(C_T, z, value)
    for j in range(n):
        rhs[j] = z_error[j] + gamma_C * abs(z[j])
    _add_absolute_matrix_vector_product(C_T, rhs[:n], doubt)
    for i in range(N):
        doubt[i] = (doubt[i] + UNIT * abs(value[i])) * OUTWARD
    if not (
        _are_all_finite(error)
        and _is_active_set_beyond_doubt(L, U, rows, signs, lam, lam_error, value, doubt, held)
    ):
        return np.inf, x, error, y
    bound = 0.0
    for j in range(n):
        bound = max(bound, z_error[j])
    for k in range(len(rows)):
        y[rows[k]] = lam[k]
    return bound, x, error, y


@cached_njit
def classify_limits_as_ordered_crossed_or_nan(q, L, U):
    """Classify a QP's gradient and limits: ordered, crossed (some L > U) or invalid (NaN)."""
    if not _are_all_finite(q):
        return INVALID_DATA
    code = ORDERED_LIMITS
    for i in range(len(L)):
        if not (L[i] < np.inf and U[i] > -np.inf):
            return INVALID_DATA
        if L[i] > U[i]:
            code = CROSSED_LIMITS
    return code
