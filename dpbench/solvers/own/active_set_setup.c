/* Set-up of the active-set method from P and A. This file includes the method and its refinement. */

#include "active_set_care.c"

void active_set_place(active_set *s, int n, int m, as_real *reals, int *integers) {
    const size_t square = (size_t)n * (size_t)n, rows = (size_t)m * (size_t)n;
    s->n = n;
    s->m = m;
    active_set_place_step(s, reals, integers);
    active_set_let_refine(s);
    s->unit = reals += ACTIVE_SET_STEP_REALS(n, m);
    s->P = reals += n + m;
    s->G = reals += square;
    s->blocks = reals += square + rows;
    s->a = reals + square;
    s->first = integers += ACTIVE_SET_STEP_INTEGERS(n, m);
    s->parent = integers += m + 1;
    s->rest = integers += m;
    s->order = integers += m;
    s->sizes = integers += n;
    s->column = integers + n;
}

/* X := P⁻¹ in place: P = UᵀU row by row, then W = U⁻ᵀ into the lower triangle and WᵀW; 0 unless
 * P is positive definite. */
static int invert(as_real *X, int n) {
    for (int k = 0; k < n; k++) {
        as_real *row = X + (size_t)k * (size_t)n;
        if (!(row[k] > 0)) return 0;
        row[k] = 1 / root(row[k]);
        if (is_infinite(row[k])) return 0;
        for (int c = k + 1; c < n; c++) row[c] *= row[k];
        for (int i = k + 1; i < n; i++) add_scaled(X + i * n + i, -row[i], row + i, n - i);
    }
    for (int i = 0; i < n; i++) {
        as_real *row = X + (size_t)i * (size_t)n;
        clear(row, i);
        for (int k = 0; k < i; k++) add_scaled(row, -X[k * n + i], X + k * n, k + 1);
        for (int c = 0; c < i; c++) row[c] *= row[i];
    }
    for (int i = 0; i < n; i++) {
        as_real *row = X + (size_t)i * (size_t)n, t = row[i];
        for (int c = 0; c <= i; c++) row[c] *= t;
        for (int k = i + 1; k < n; k++) add_scaled(row, X[k * n + i], X + k * n, i + 1);
        for (int c = 0; c < i; c++) X[c * n + i] = row[c];
    }
    return 1;
}

/* The last row of A before row i whose entries begin those of row i; −1 if there is none. Sums over
 * the horizon are such rows. */
static int find_parent(const active_set *s, int i) {
    const int *first = s->first;
    for (int p = i - 1; p >= 0; p--) {
        const int count = first[p + 1] - first[p];
        int same = 0;
        while (same < count && first[i] + same < first[i + 1] &&
               s->column[first[p] + same] == s->column[first[i] + same] &&
               s->a[first[p] + same] == s->a[first[i] + same])
            same++;
        if (count > 0 && same == count) return p;
    }
    return -1;
}

/* The entries of A, A P⁻¹ and the lengths of all rows. */
static int write_rows(active_set *s, const as_real *A) {
    const int n = s->n, N = n + s->m;
    as_real *a = (as_real *)s->a, *unit = (as_real *)s->unit, *G = (as_real *)s->G;
    int *first = (int *)s->first, *column = (int *)s->column, *parent = (int *)s->parent;
    int *rest = (int *)s->rest, end = 0;
    s->longest = 0;
    s->largest = 1;
    for (int i = 0; i < N; i++, G += n) {
        if (i >= n) {
            first[i - n] = end;
            clear(G, n);
            for (int c = 0; c < n; c++) {
                const as_real x = *A++;
                if (is_infinite(x)) return ACTIVE_SET_DATA_NOT_FINITE;
                if (x == 0) continue;
                a[end] = x;
                column[end++] = c;
                s->largest = larger(s->largest, size_of(x));
                add_scaled(G, x, inverse_row(s, c), n);
            }
            first[i - n + 1] = end;
            const int found = parent[i - n] = find_parent(s, i - n);
            rest[i - n] = first[i - n] + (found < 0 ? 0 : first[found + 1] - first[found]);
        }
        const as_real length = root(larger(entry(s, i, i), 0));
        unit[i] = length > ZERO_ROW ? 1 / length : 1;
        s->longest = larger(s->longest, length);
    }
    if (s->m == 0) first[0] = 0;
    return ACTIVE_SET_OK;
}

int active_set_replace_rows(active_set *s, const as_real *A) {
    const int refused = write_rows(s, A);
    if (refused == ACTIVE_SET_OK && s->warm && !s->stale) renew_set(s);
    else s->stale = 1;
    return refused;
}

/* loss := the largest entry of P P⁻¹x − x for an x of ±1: what rounding leaves of a gradient of 1. */
static void measure_loss(active_set *s) {
    const int n = s->n;
    for (int c = 0; c < n; c++) s->e[c] = REAL(c % 3 ? 1 : -1);
    multiply_inverse(s, s->r, 1, s->e);
    for (int c = 0; c < n; c++) s->e[c] = -s->e[c];
    add_product(s, s->e, s->r);
    s->loss = largest_of(s->e, n);
}

static void swap(int *x, int *y) {
    const int t = *x;
    *x = *y;
    *y = t;
}

/* Order the variables by the parts that P falls into, and copy P⁻¹ of each part. */
static void write_parts(active_set *s) {
    const int n = s->n;
    int *order = (int *)s->order, *sizes = (int *)s->sizes, begin = 0, rest = n;
    as_real *block = (as_real *)s->blocks;
    for (int i = 0; i < n; i++) order[i] = i;
    while (begin < rest) {
        int end = begin + 1;
        for (int k = begin; k < end; k++)
            for (int j = end; j < rest; j++)
                if (s->P[order[k] * n + order[j]] != 0) swap(order + end++, order + j);
        sizes[begin] = end - begin;
        if (end == begin + 1) {
            swap(order + begin, order + --rest);
            continue;
        }
        for (int k = begin; k < end; k++)
            for (int j = begin; j < end; j++) *block++ = s->G[order[k] * n + order[j]];
        begin = end;
    }
    s->coupled = begin;
}

int active_set_factorise(active_set *s, const as_real *P, const as_real *A) {
    const int n = s->n;
    as_real *own = (as_real *)s->P, *G = (as_real *)s->G;
    s->steepest = s->widest = 0;
    for (int i = 0; i < n; i++) {
        as_real sum = 0;
        for (int c = 0; c < n; c++) {
            const as_real p = (P[i * n + c] + P[c * n + i]) / 2;
            own[i * n + c] = G[i * n + c] = p;
            sum += size_of(p);
        }
        if (is_infinite(sum)) return ACTIVE_SET_DATA_NOT_FINITE;
        s->steepest = larger(s->steepest, sum);
    }
    if (!invert(G, n)) return ACTIVE_SET_NOT_DEFINITE;
    write_parts(s);
    for (int i = 0; i < n; i++) {
        as_real sum = 0;
        for (int c = 0; c < n; c++) sum += size_of(inverse_row(s, i)[c]);
        s->widest = larger(s->widest, sum);
    }
    measure_loss(s);
    return active_set_replace_rows(s, A);
}
