/* The active-set method of the paper; active_set.h says how it is called.
 *
 * With the active rows W at their limits g, H = C P⁻¹ Cᵀ and base = −P⁻¹q, the optimum is
 *
 *     λ_W = H_WW⁻¹ (C_W base − g)                                                       (eq. 31)
 *     z   = base − Σ λ_i P⁻¹c_i                                                         (eq. 32)
 *
 * and eq. 30 asks for the W whose multipliers have the sign of their limit and whose z keeps all
 * others. The paper leaves open which W to try next. Here the set of the step before is the start.
 * Where a multiplier has the wrong sign, λ goes towards eq. 31 until the first one reaches zero,
 * whose row is dropped. From that set the rule of Goldfarb
 * and Idnani (Math. Programming 27 (1983) 1-33) goes on: the most violated row is brought in, and
 * rows whose multiplier reaches zero on the way are dropped. Every row brought in raises the dual
 * objective, so that no set comes back.
 *
 * Arrays, for n variables and m rows of A, i a row of C = [I; A], k a place in W:
 *
 *              n                   i: 0 … n−1 bounds, n … n+m−1 rows of A
 *          ┌───────┐
 *     P  n │ P     │               L     k = 0 │ 1/L₀₀                 packed; k-th row belongs to
 *          ├───────┤                         1 │ L₁₀ 1/L₁₁             i = active[k]
 *     G  n │ P⁻¹   │                         2 │ L₂₀ L₂₁ 1/L₂₂
 *        m │ A P⁻¹ │
 *          └───────┘               H_ij = c_iᵀ P⁻¹ c_j is row i of G times c_j: an entry of it where j
 *     A: column, value of each entry         is a bound, a few products where it is a row of A
 *
 * By hand: the point nearest (3, 3) under z₀ ≤ 1, z₁ ≤ 1, z₀ + z₁ ≤ 2.5: P = I, q = (−3, −3), and
 * row 2 is that of A, with H₂₂ = 2, H₀₂ = H₁₂ = 1.
 *
 *     what happens                                          λ₀    λ₁    λ₂    z
 *     q alone; violated, in lengths of the rows, are the                      (3, 3)
 *       bounds by 2 each, row 2 by 3.5/√2 = 2.47
 *     1 row 2 comes in: λ₂ = 3.5/H₂₂                                    1.75  (1.25, 1.25)
 *     2 row 0, the first of two violated by 0.25: ½ of it
 *       lies along row 2, so 1 − ½·1 = ½ of its length²
 *       is its own; λ₀ = 0.25/½, λ₂ −= ½ λ₀                 0.5         1.5   (1, 1.5)
 *     3 row 1, violated by 0.5, is row 2 less row 0: no
 *       step along z. As λ₁ grows, λ₂ falls and λ₀ grows
 *       alike; at 1.5 λ₂ is zero and row 2 is dropped       2.0   (1.5) 0     (1, 1.5)
 *     4 row 1 is free of row 0 now: λ₁ += 0.5/1             2.0   2.0         (1, 1)
 *
 * The slope z − (3, 3) + (λ₀, λ₁) is zero there and both λ ≥ 0: the optimum.
 *
 * A controller whose P stays needs this file alone: active_set_place_step and active_set_solve. */

#include "active_set.h"

#include <math.h>

#define REAL(x) ((as_real)(x))
#ifdef ACTIVE_SET_FLOAT
#define EPSILON REAL(1.2e-7)
#define SPLITTER REAL(4097)
#define ROUNDING_OF(share) REAL(((share) * 5.4e8 < 0.1 ? (share) * 5.4e8 : 0.1))
#define TINY REAL(1e-35)
#define ZERO_ROW REAL(1e-18)
#else
#define EPSILON REAL(2.3e-16)
#define SPLITTER REAL(134217729)
#define ROUNDING_OF(share) REAL(share)
#define TINY REAL(1e-300)
#define ZERO_ROW REAL(1e-150) /* a shorter row is zero: its square underflows */
#endif

/* Shares of the terms that a quantity is computed from. */
#define VIOLATED ROUNDING_OF(1e-13)  /* a row beyond its limit by more is violated */
#define DEPENDENT ROUNDING_OF(1e-11) /* a row no farther from the active ones combines from them */
#define CLOSE ROUNDING_OF(1e-6)      /* a squared distance below it is computed anew */
#define NO_PART ROUNDING_OF(1e-11)   /* a smaller share in a combination is rounding */
#define GROSS REAL(1e-4)             /* a contradiction by so much needs no refined values */
#define NEAR ROUNDING_OF(1e-8)          /* a row so near its limit may be active */
#define KEPT REAL(0.95)           /* of its violation: a row found is brought in, others did not cure it */
#define SHARE REAL(0.3)           /* of the worst violation, by which others are still brought in */
#define ON_LIMIT ROUNDING_OF(1e-13) /* an active row so near its limit needs no refinement */
#define SMALL ROUNDING_OF(1e-9)         /* allowed in a row, and in the gradient of 1 + |q| */
enum { POLISHES = 8, ITERATIONS_PER_ROW = 20, NEITHER = 0, LEFT_OUT = 2 };
enum { OPTIMAL = 0, DOUBTFUL = -10, UNREFINED = -11, CONTRADICTED = -12 };

static as_real root(as_real x) { return (as_real)sqrt((double)x); }
static as_real size_of(as_real x) { return (as_real)fabs((double)x); }
static as_real larger(as_real x, as_real y) { return x > y ? x : y; }
static int is_infinite(as_real x) { return x - x != REAL(0); } /* or NaN */

/* A microcontroller has little room: there Clang compiles all but the innermost loop for size. Other
 * loops have few rounds, and unrolled they would be larger and hardly faster. */
#if defined(__clang__) && __SIZEOF_POINTER__ == 4
#define KERNEL __attribute__((noinline))
#define SINGLE __attribute__((always_inline))
#define SELDOM __attribute__((noinline, minsize)) /* as small as can be */
#define FOR_SIZE
#else
#define KERNEL
#define SINGLE
#define SELDOM
#endif
#ifdef __GNUC__
#define RARE __attribute__((noinline, cold)) /* its registers are not those of the loop around it */
#else
#define RARE
#endif

/* ---- vectors ------------------------------------------------------------------------------- */

/* out += a x + b y + c u + d v: four vectors at a time cost one look at the result. */
KERNEL static void add_four(as_real *restrict out, int n, as_real a, const as_real *restrict x,
                            as_real b, const as_real *restrict y, as_real c,
                            const as_real *restrict u, as_real d, const as_real *restrict v) {
#ifdef FOR_SIZE
#pragma clang loop unroll_count(2) /* by four it would need more registers than it may use */
#endif
    for (int i = 0; i < n; i++) out[i] += (a * x[i] + b * y[i]) + (c * u[i] + d * v[i]);
}

#ifdef FOR_SIZE
#pragma clang attribute push(__attribute__((cold)), apply_to = function)
#endif

static as_real dot(const as_real *x, const as_real *y, int n) {
    as_real a = 0, b = 0;
    for (; n > 1; n -= 2, x += 2, y += 2) {
        a += x[0] * y[0];
        b += x[1] * y[1];
    }
    return n ? a + b + *x * *y : a + b;
}

static void clear(as_real *x, int n) {
    for (int i = 0; i < n; i++) x[i] = 0;
}

static void copy(as_real *to, const as_real *from, int n) {
    for (const as_real *end = from + n; from < end;) *to++ = *from++;
}

/* out += t x */
static void add_scaled(as_real *restrict out, as_real t, const as_real *restrict x, int n) {
    for (int i = 0; i < n; i++) out[i] += t * x[i];
}

static as_real largest_of(const as_real *x, int n) {
    as_real most = 0;
    for (int i = 0; i < n; i++) most = larger(most, size_of(x[i]));
    return most;
}

/* out += Σ x_k M_k over the n rows M_k of a square matrix */
SINGLE static void add_square(as_real *restrict out, const as_real *M, const as_real *x, int n) {
    int k = 0;
    for (; k + 2 < n; k += 4) {
        const int last = k + 3 < n ? 3 : 0;
        const as_real *rows = M + k * n;
        add_four(out, n, x[k], rows, x[k + 1], rows + n, x[k + 2], rows + 2 * n,
                 last ? x[k + 3] : 0, rows + last * n);
    }
    for (; k < n; k++) add_scaled(out, x[k], M + k * n, n);
}

/* out += sign Σ x_k M_k over the rows M_k of n numbers that are listed */
static void add_rows(as_real *restrict out, as_real sign, const as_real *M, const as_real *x,
                     const int *listed, int count, int n) {
    for (; count > 2; count -= 4, listed += 4) {
        const int i = listed[0], j = listed[1], k = listed[2], last = count > 3 ? listed[3] : i;
        add_four(out, n, sign * x[i], M + i * n, sign * x[j], M + j * n, sign * x[k], M + k * n,
                 count > 3 ? sign * x[last] : 0, M + last * n);
    }
    for (; count > 0; count--, listed++)
        add_scaled(out, sign * x[*listed], M + *listed * n, n);
}

/* out := sign P⁻¹x, part by part of the variables that P couples; `out` may be x */
static void multiply_inverse(const active_set *s, as_real *out, as_real sign, const as_real *x) {
    as_real *from = s->from, *to = s->to;
    const int *order = s->order, *end = order + s->n, *single = order + s->coupled;
    const as_real *block = s->blocks;
    while (order < single) {
        const int size = s->sizes[order - s->order];
        for (int k = 0; k < size; k++) {
            from[k] = sign * x[order[k]];
            to[k] = 0;
        }
        add_square(to, block, from, size);
        for (int k = 0; k < size; k++) out[*order++] = to[k];
        block += size * size;
    }
    for (; order < end; order++) out[*order] = sign * x[*order] * s->G[*order * (s->n + 1)];
}

/* b := L⁻¹ b over the first w rows: two rows and two columns at a time, the last row of an odd w apart */
static void substitute_forward(const as_real *L, as_real *b, int w) {
    int k = 0;
    for (; k + 1 < w; k += 2) {
        const as_real *next = L + k + 1, *solved = b;
        as_real x = b[k], y = b[k + 1];
        for (int left = k; left > 0; left -= 2, solved += 2, L += 2, next += 2) {
            x -= L[0] * solved[0] + L[1] * solved[1];
            y -= next[0] * solved[0] + next[1] * solved[1];
        }
        b[k] = x *= *L;
        b[k + 1] = (y - next[0] * x) * next[1];
        L = next + 2;
    }
    if (k < w) b[k] = (b[k] - dot(L, b, k)) * L[k];
}

/* b := L⁻ᵀ b */
static void substitute_backward(const as_real *L, as_real *b, int w) {
    const as_real *end = L + w * (w + 1) / 2;
    if (w & 1) {
        b[--w] *= *--end;
        end -= w;
        add_scaled(b, -b[w], end, w);
    }
    for (int k = w - 2; k >= 0; k -= 2) {
        const as_real *next = end - k - 2, *row = end = next - k - 1;
        const as_real y = b[k + 1] * next[k + 1], x = (b[k] - next[k] * y) * row[k];
        b[k] = x;
        b[k + 1] = y;
        as_real *to = b;
        for (int left = k; left > 0; left -= 2, to += 2, row += 2, next += 2) {
            const as_real first = x * row[0] + y * next[0], second = x * row[1] + y * next[1];
            to[0] -= first;
            to[1] -= second;
        }
    }
}

/* ---- rows of C ----------------------------------------------------------------------------- */

static const as_real *inverse_row(const active_set *s, int i) {
    return s->G + (size_t)i * (size_t)s->n;
}

/* c_iᵀx */
static as_real row_times(const active_set *s, int i, const as_real *x) {
    if (i < s->n) return x[i];
    const int *first = s->first + (i - s->n), *column = s->column + *first;
    const as_real *a = s->a + *first;
    as_real sum = 0, odd = 0;
    int count = first[1] - *first;
    for (; count > 1; count -= 2, a += 2, column += 2) {
        sum += a[0] * x[column[0]];
        odd += a[1] * x[column[1]];
    }
    return count ? sum + odd + *a * x[*column] : sum + odd;
}

/* x += t c_i */
static void add_row(const active_set *s, int i, as_real t, as_real *x) {
    if (i < s->n) {
        x[i] += t;
        return;
    }
    for (int e = s->first[i - s->n]; e < s->first[i - s->n + 1]; e++)
        x[s->column[e]] += t * s->a[e];
}

/* H_ij = c_iᵀ P⁻¹ c_j */
static as_real entry(const active_set *s, int i, int j) {
    return i < s->n ? inverse_row(s, j)[i] : row_times(s, i, inverse_row(s, j));
}

/* x += sign Σ λ_i P⁻¹c_i over the active rows */
static void add_active_rows(const active_set *s, as_real *x, as_real sign) {
    add_rows(x, sign, s->G, s->lam, s->active, s->count, s->n);
}

/* The values of the rows of A at z, behind z. */
static void write_row_values(active_set *s) {
    const as_real *z = s->z, *a = s->a;
    const int *column = s->column, *end = s->first, *parent = s->parent, *rest = s->rest;
    as_real *values = s->z + s->n;
    for (as_real *value = values, *last = values + s->m; value < last; parent++) {
        as_real v = *parent < 0 ? 0 : values[*parent];
        end++;
        for (int e = *rest++; e < *end; e++) v += a[e] * z[column[e]];
        *value++ = v;
    }
}

static as_real limit_of(const active_set *s, int i) {
    return s->side[i] > 0 ? s->high[i] : s->low[i];
}

/* Or NaN, or equal and infinite, which leave no number. */
static int has_crossed_limits(const active_set *s, int i) {
    return !(s->low[i] <= s->high[i]) || (s->low[i] == s->high[i] && is_infinite(s->low[i]));
}

SELDOM static int has_wrong_sign(const active_set *s, int i, as_real lam) {
    return (s->side[i] > 0 ? lam < 0 : lam > 0) && s->low[i] < s->high[i];
}

/* ---- the factor of H_WW -------------------------------------------------------------------- */

static as_real *factor_row(const active_set *s, int k) { return s->L + (size_t)k * (size_t)(k + 1) / 2; }

/* Append row i, whose part of the factor is in T, with a pivot d. */
static void append_row(active_set *s, int i, int side, as_real d) {
    const int w = s->count++;
    as_real *L = factor_row(s, w);
    copy(L, s->T, w);
    L[w] = 1 / root(d);
    s->active[w] = i;
    s->side[i] = side;
}

/* Refine the combination R of active rows for row j, and T, once unless it is exact; returns the
 * square of the distance of row j from them in the norm of P⁻¹, of `square`, that of its length:
 * y = c_j − Σ R_k c_k is formed and yᵀP⁻¹y taken. */
SELDOM static as_real refine_combination(active_set *s, int j, as_real square) {
    const int n = s->n, w = s->count;
    as_real *y = s->r, *x = s->e, *more = s->r_low;
    for (int again = 0;; again++) {
        clear(y, n);
        add_row(s, j, 1, y);
        for (int k = 0; k < w; k++) add_row(s, s->active[k], -s->R[k], y);
        multiply_inverse(s, x, 1, y);
        const as_real d = dot(x, y, n);
        if (again || d <= VIOLATED * VIOLATED * square) return larger(d, 0);
        for (int k = 0; k < w; k++) more[k] = row_times(s, s->active[k], x);
        substitute_forward(s->L, more, w);
        add_scaled(s->T, 1, more, w);
        substitute_backward(s->L, more, w);
        add_scaled(s->R, 1, more, w);
    }
}

/* T := H_Wj */
static void write_entries(active_set *s, int j) {
    for (int k = 0; k < s->count; k++) s->T[k] = entry(s, s->active[k], j);
}

/* R := L⁻ᵀT */
static void write_combination(active_set *s) {
    copy(s->R, s->T, s->count);
    substitute_backward(s->L, s->R, s->count);
}

/* R := the combination of active rows that is row j but for a rest, T = L⁻¹H_Wj given; returns the
 * square of the length of that rest in the norm of P⁻¹, of that of row j. */
static as_real split(active_set *s, int j, as_real square) {
    const int w = s->count, whole = w == s->n; /* n rows combine every other one: d is rounding */
    const as_real d = square - dot(s->T, s->T, w);
    write_combination(s);
    if (w > 0 && (whole ? size_of(d) > DEPENDENT * square : d < CLOSE * square))
        return refine_combination(s, j, square);
    return d;
}

static void leave(active_set *s, int i) {
    s->side[i] = NEITHER;
    s->lam[i] = 0;
}

/* Drop the k-th active row: plane rotations of pairs of columns make the factor triangular again. Each
 * row moves to the one before; what the next rotation turns stays behind. T, L⁻¹ of something,
 * becomes that of the same without this row. */
SELDOM static void drop_row(active_set *s, int k) {
    const int w = --s->count;
    as_real last = s->T[k], *row = factor_row(s, k), *to = row + k;
    leave(s, s->active[k]);
    for (int r = k; r < w; row += ++r) {
        s->active[r] = s->active[r + 1];
        copy(row, row + r + 1, k);
    }
    for (; k < w; to++) {
        const as_real x = to[k + 1], y = 1 / to[k + 2], h = root(x * x + y * y), p = x / h, q = y / h;
        const as_real next = s->T[k + 1];
        s->T[k] = p * last + q * next;
        last = p * next - q * last;
        *to = 1 / h;
        as_real *from = to += ++k;
        for (ptrdiff_t length = k + 1; length <= w; length++) {
            as_real *before = from;
            from += length;
            const as_real u = from[0], v = from[1];
            *before = p * u + q * v;
            from[1] = p * v - q * u;
        }
    }
}

/* ---- multipliers --------------------------------------------------------------------------- */

/* T := L⁻¹(C_W x − g): with x = base L⁻ᵀT are the multipliers of eq. 31. Returns a place in W whose
 * limit is infinite, −1 if none is. */
static int write_distances(active_set *s, const as_real *x) {
    for (int k = 0; k < s->count; k++) {
        const as_real g = limit_of(s, s->active[k]);
        if (is_infinite(g)) return k;
        s->T[k] = row_times(s, s->active[k], x) - g;
    }
    substitute_forward(s->L, s->T, s->count);
    return -1;
}

/* λ_W −= t R */
static void advance(active_set *s, as_real t) {
    for (int k = 0; k < s->count; k++) s->lam[s->active[k]] -= t * s->R[k];
}

/* The active row whose multiplier is first to reach zero as `advance` goes up to t, and t := when; −1
 * if none does. `part`: a smaller share of a row in R is rounding. */
static int find_blocking(const active_set *s, as_real side, as_real part, as_real *t) {
    int blocking = -1;
    for (int k = 0; k < s->count; k++) {
        const int i = s->active[k];
        const as_real a = (s->side[i] > 0 ? side : -side) * s->R[k], lam = s->side[i] > 0 ? s->lam[i] : -s->lam[i];
        if (!(a > part * s->unit[i]) || !(lam < a * *t) || s->low[i] == s->high[i]) continue;
        blocking = k;
        *t = larger(lam / a, 0);
    }
    return blocking;
}

/* Take λ towards eq. 31, dropping the row whose multiplier is first to reach zero, until all signs
 * are right. By hand, the point nearest (2, 1) and then (1, −2) under z₀ ≤ 0 and z₁ − z₀ ≤ 0:
 *
 *     what happens                                                      λ₀    λ₂    z
 *     the step before ends at the corner, both rows active              3     1     (0, 0)
 *     eq. 31 asks for −1 and −2 of them: λ₀ would be zero after ¾ of
 *       the way, λ₂ after 1/(1 + 2) = ⅓ of it. It is dropped there      5/3   0
 *     and eq. 31 asks for 1 of row 0 alone: no row has to come in       1     0     (0, −2) */
static void restore_signs(active_set *s) {
    for (int k; (k = write_distances(s, s->base)) >= 0;) drop_row(s, k);
    for (;; s->iterations++) {
        int wrong = 0;
        as_real t = 1;
        write_combination(s);
        for (int k = 0; k < s->count; k++) wrong += has_wrong_sign(s, s->active[k], s->R[k]);
        if (!wrong) break;
        for (int k = 0; k < s->count; k++) {
            as_real *lam = s->lam + s->active[k];
            if (has_wrong_sign(s, s->active[k], *lam)) *lam = 0; /* its limits were equal */
            s->R[k] = *lam - s->R[k];
        }
        const int k = find_blocking(s, 1, 0, &t);
        advance(s, t);
        if (k < 0) return;
        drop_row(s, k);
    }
    for (int k = 0; k < s->count; k++) s->lam[s->active[k]] = s->R[k];
}

/* Make row i active on a side unless it leans on the active ones. */
SELDOM static void add_to_start(active_set *s, int i, int side) {
    const as_real square = entry(s, i, i);
    if (s->count == s->n) return;
    write_entries(s, i);
    substitute_forward(s->L, s->T, s->count);
    const as_real d = square - dot(s->T, s->T, s->count);
    if (d > CLOSE * square) append_row(s, i, side, d);
}

/* First, so that no row is brought in that they make superfluous. */
SELDOM static void add_equalities(active_set *s) {
    for (int i = 0; i < s->n + s->m; i++)
        if (s->low[i] == s->high[i] && s->side[i] == NEITHER) add_to_start(s, i, 1);
}

/* z = base − Σ λ_i P⁻¹c_i and the values of the rows (eq. 32) */
static void write_point(active_set *s) {
    copy(s->z, s->base, s->n);
    add_active_rows(s, s->z, -1);
    write_row_values(s);
}

/* ---- violated rows ------------------------------------------------------------------------- */

/* How far row i, at v, is beyond a limit, over its length and less the rounding of the limit. */
static as_real violation(const active_set *s, int i, as_real v) {
    const as_real over = v - s->high[i], under = s->low[i] - v;
    return s->unit[i] * (over > under ? over - VIOLATED * size_of(s->high[i])
                                      : under - VIOLATED * size_of(s->low[i]));
}

/* A few for few variables: where a look is cheap, another one saves rows that would be dropped again. */
SELDOM static void insert(active_set *s, int i, as_real by) {
    active_set_view *found = &s->found;
    int k = found->count;
    if (k <= s->n / 4 && k < ACTIVE_SET_CANDIDATES) found->count++;
    else if (by <= found->by[--k]) return;
    for (; k > 0 && found->by[k - 1] < by; k--) {
        found->by[k] = found->by[k - 1];
        found->rows[k] = found->rows[k - 1];
    }
    found->by[k] = by;
    found->rows[k] = i;
}

/* Look at a row that is not active, or cannot be, and is near a limit or beyond one. */
SELDOM RARE static void look_at(active_set *s, int i, as_real noise, as_real close) {
    active_set_view *found = &s->found;
    const as_real v = s->z[i], low = s->low[i], high = s->high[i], u = s->unit[i];
    if ((v - high) * u < -close && (low - v) * u < -close) return;
    found->crossed |= has_crossed_limits(s, i);
    if (s->side[i] != NEITHER) return;
    found->near = 1;
    found->equal |= low == high;
    const as_real by = violation(s, i, v);
    if (by > noise) insert(s, i, by);
}

/* Whether a row is active or far from its limits, as most are; with a NaN or crossed limits none is. */
static int is_no_news(const active_set *s, int i, as_real v, as_real low, as_real high, as_real far) {
    return (high - v > far && v - low > far) || (s->side[i] != NEITHER && low < high);
}

static void look(active_set *s, as_real noise, as_real close) {
    active_set_view *found = &s->found;
    found->count = found->near = found->equal = found->crossed = 0;
    const as_real *z = s->z, *low = s->low, *high = s->high;
    const as_real far = close * larger(s->longest, 1);
    const int N = s->n + s->m;
    int i = 0;
    for (; i + 1 < N; i += 2, z += 2, low += 2, high += 2) {
        if (!is_no_news(s, i, *z, *low, *high, far)) look_at(s, i, noise, close);
        if (!is_no_news(s, i + 1, z[1], low[1], high[1], far)) look_at(s, i + 1, noise, close);
    }
    if (i < N && !is_no_news(s, i, *z, *low, *high, far)) look_at(s, i, noise, close);
}

/* λ := the ray by which row j contradicts the active rows that it combines; T keeps that of before. */
SELDOM static int write_ray(active_set *s, int j, as_real side) {
    const as_real rounding = VIOLATED * larger(1, largest_of(s->R, s->count));
    for (int k = 0; k < s->count; k++) {
        as_real *lam = s->lam + s->active[k];
        s->T[k] = *lam;
        *lam = size_of(s->R[k]) > rounding ? -side * s->R[k] : 0;
    }
    s->lam[j] = side;
    return CONTRADICTED;
}

/* Raise the multiplier of row j, T = H_Wj given, beyond its limit on side `which` by `gap`, until it is met. A dependent
 * row that nothing blocks contradicts the active ones if gap is more than `allowed`; if it is not,
 * rounding decides. */
static int activate(active_set *s, int j, int which, as_real gap, as_real allowed) {
    const as_real side = REAL(which), square = entry(s, j, j);
    as_real lam = 0;
    substitute_forward(s->L, s->T, s->count);
    while (s->iterations < ITERATIONS_PER_ROW * (s->n + s->m)) {
        s->iterations++;
        const as_real d = split(s, j, square);
        const int whole = s->count == s->n, dependent = whole || d <= DEPENDENT * DEPENDENT * square;
        as_real t = dependent ? 1 / TINY : gap / d;
        /* A step that nothing else ends would have no end: no row blocks it by rounding. */
        const int blocking = find_blocking(s, side, dependent ? NO_PART / s->unit[j] : 0, &t);
        if (dependent && blocking < 0) {
            if (!(gap * s->unit[j] > allowed)) return DOUBTFUL;
            refine_combination(s, j, 0); /* a proof has no rounding to spare */
            return write_ray(s, j, side);
        }
        advance(s, t * side);
        lam += t * side;
        if (blocking < 0) {
            s->lam[j] = lam;
            append_row(s, j, which, d);
            return OPTIMAL;
        }
        if (!dependent) gap -= t * d;
        drop_row(s, blocking);
    }
    return DOUBTFUL;
}

/* Bring violated rows in until none is left, beginning with those found, which are renewed. Of those
 * of one look all are brought in that are still violated: a look costs as much as several rows. */
static int activate_violated(active_set *s, as_real noise, as_real close, as_real size) {
    active_set_view *found = &s->found;
    while (found->count > 0) {
        for (int c = 0; c < found->count; c++) {
            const int j = found->rows[c];
            as_real v = s->z[j];
            write_entries(s, j);
            if (c > 0) { /* z is that of before */
                v = row_times(s, j, s->base);
                for (int k = 0; k < s->count; k++) v -= s->lam[s->active[k]] * s->T[k];
                if (violation(s, j, v) <= larger(SHARE * found->by[0], KEPT * found->by[c])) continue;
            }
            const int which = v > s->high[j] ? 1 : -1;
            const as_real g = which > 0 ? s->high[j] : s->low[j];
            const as_real allowed = GROSS * (size_of(g) * s->unit[j] + size);
            const int ending = activate(s, j, which, REAL(which) * (v - g), allowed);
            if (ending != OPTIMAL) return ending;
        }
        write_point(s);
        look(s, noise, close);
    }
    return OPTIMAL;
}

/* ---- a solve ------------------------------------------------------------------------------- */

/* base := −P⁻¹q; returns the square of its length in the norm of P, infinite or NaN if q is. */
static as_real write_base(active_set *s) {
    multiply_inverse(s, s->base, -1, s->q);
    return -dot(s->q, s->base, s->n);
}

/* Whether the active rows are at their limits, P⁻¹q of a given length, and multipliers have their
 * signs, as restore_signs leaves them. */
static int is_settled(const active_set *s, as_real size, int moved) {
    for (int k = 0; k < s->count; k++) {
        const int i = s->active[k];
        const as_real g = limit_of(s, i), off = size_of(s->z[i] - g);
        if (!(off * s->unit[i] <= ON_LIMIT * size + TINY)) return 0;
        if (off > SMALL * REAL(1e-3) * (1 + size_of(g))) return 0;
        if (moved && has_wrong_sign(s, i, s->lam[i])) return 0;
    }
    return 1;
}

/* Move z and λ so that what the active rows miss by rounding is corrected. */
SELDOM static void settle(active_set *s) {
    write_distances(s, s->z);
    write_combination(s);
    advance(s, -1);
    for (int k = 0; k < s->count; k++)
        add_scaled(s->z, -s->R[k], inverse_row(s, s->active[k]), s->n);
    write_row_values(s);
}

static int search(active_set *s) {
    if (s->stale || !s->warm) {
        for (int i = 0; i < s->n + s->m; i++) leave(s, i);
        s->count = 0;
    }
    s->stale = s->iterations = 0;
    const as_real square = write_base(s);
    if (is_infinite(square)) return ACTIVE_SET_NOT_FINITE;
    const as_real size = root(larger(square, 0)), coarse = VIOLATED * size, close = 4 * NEAR * size;
    if (s->count > 0) restore_signs(s);
    write_point(s);
    look(s, coarse, close);
    if (s->found.crossed) return ACTIVE_SET_CROSSED;
    if (s->found.equal) {
        add_equalities(s);
        restore_signs(s);
        write_point(s);
        look(s, coarse, close);
    }
    const int ending = activate_violated(s, coarse, close, 2 * size);
    if (ending != OPTIMAL) return ending;
    if (is_settled(s, size, s->iterations)) return s->iterations;
    if (s->refine) return UNREFINED;
    settle(s);
    return is_settled(s, size, 1) ? s->iterations : UNREFINED;
}

int active_set_solve(active_set *s) {
    int ending = search(s);
    if (s->refine) ending = s->refine(s, ending);
    else if (ending <= DOUBTFUL)
        ending = ending == CONTRADICTED ? ACTIVE_SET_INFEASIBLE : ACTIVE_SET_INACCURATE;
    s->stale = ending < 0 && ending != ACTIVE_SET_INACCURATE;
    return ending;
}

SELDOM void active_set_place_step(active_set *s, as_real *reals, int *integers) {
    const int n = s->n, N = n + s->m;
    as_real **const vectors[] = {
        &s->q, &s->base, &s->R, &s->T, &s->r, &s->e,
        &s->z_low, &s->lam_low, &s->r_low, &s->from, &s->to};
    as_real **const long_ones[] = {&s->low, &s->high, &s->z, &s->lam};
    s->warm = s->block = s->count = s->iterations = 0;
    s->stale = 1;
    for (int k = 0; k < 4; k++, reals += N) *long_ones[k] = reals;
    for (int k = 0; k < 11; k++, reals += n) *vectors[k] = reals;
    s->L = reals;
    s->active = integers;
    s->side = integers + n;
}

#ifdef FOR_SIZE
#pragma clang attribute pop
#endif
