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

/* out += sign Σ X_ki X_k over the first `length` numbers of `count` rows X_k, which begin at `row`;
 * X_ki is i numbers after that. */
static void add_own_rows(
    as_real *out, int length, as_real sign, const as_real *row, int i, int count, int n) {
    for (; count > 3; count -= 4, row += 4 * n)
        add_four(out, length, sign * row[i], row, sign * row[n + i], row + n,
                 sign * row[2 * n + i], row + 2 * n, sign * row[3 * n + i], row + 3 * n);
    for (; count > 0; count--, row += n) add_scaled(out, sign * row[i], row, length);
}

/* X := X⁻¹ in place, from its upper triangle: X = UᵀU row by row, then W = U⁻ᵀ into the lower
 * triangle and WᵀW; 0 unless X is positive definite. */
static int invert(as_real *X, int n) {
    as_real *row = X;
    for (int i = 0; i < n; i++, row += n) {
        add_own_rows(row + i, n - i, -1, X + i, 0, i, n);
        if (!(row[i] > 0)) return 0;
        row[i] = 1 / root(row[i]);
        if (is_infinite(row[i])) return 0;
        for (int c = i + 1; c < n; c++) row[c] *= row[i];
    }
    row = X;
    for (int i = 0; i < n; i++, row += n) {
        clear(row, i);
        for (int k = 0; k < i; k += 4) { /* rows k … k+3 of W begin with k+1, k+2 … numbers */
            const int four = k + 4 <= i ? 4 : i - k;
            add_own_rows(row, k + 1, -1, X + k * n, i, four, n);
            for (int j = 1; j < four; j++)
                add_scaled(row + k + 1, -X[(k + j) * n + i], X + (k + j) * n + k + 1, j);
        }
        for (int c = 0; c < i; c++) row[c] *= row[i];
    }
    row = X;
    for (int i = 0; i < n; i++, row += n) {
        const as_real t = row[i];
        for (int c = 0; c <= i; c++) row[c] *= t;
        add_own_rows(row, i + 1, 1, row + n, i, n - 1 - i, n);
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
            const int k = i - n;
            first[k] = end;
            for (int c = 0; c < n; c++) {
                const as_real x = *A++;
                if (is_infinite(x)) return ACTIVE_SET_DATA_NOT_FINITE;
                if (x == 0) continue;
                a[end] = x;
                column[end++] = c;
                s->largest = larger(s->largest, size_of(x));
            }
            first[k + 1] = end;
            const int found = parent[k] = find_parent(s, k);
            rest[k] = first[k];
            if (found < 0) clear(G, n);
            else {
                copy(G, inverse_row(s, n + found), n);
                rest[k] += first[found + 1] - first[found];
            }
            for (int e = rest[k]; e < end; e++) add_scaled(G, a[e], inverse_row(s, column[e]), n);
        }
        const as_real length = root(larger(entry(s, i, i), 0));
        unit[i] = length > ZERO_ROW ? 1 / length : 1;
        s->longest = larger(s->longest, length);
    }
    if (s->m == 0) first[0] = 0;
    return ACTIVE_SET_OK;
}

/* Factorise the set anew, without rows that lean on the others now. */
static void renew_set(active_set *s) {
    const int w = s->count;
    s->count = 0;
    for (int k = 0; k < w; k++) {
        const int i = s->active[k], side = s->side[i];
        const as_real lam = s->lam[i];
        leave(s, i);
        add_to_start(s, i, side);
        if (s->side[i] != NEITHER) s->lam[i] = lam;
    }
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

static as_real sum_of_sizes(const as_real *x, int n) {
    as_real a = 0, b = 0, c = 0, d = 0;
    for (; n > 3; n -= 4, x += 4) {
        a += size_of(x[0]);
        b += size_of(x[1]);
        c += size_of(x[2]);
        d += size_of(x[3]);
    }
    for (; n > 0; n--) a += size_of(*x++);
    return (a + b) + (c + d);
}

/* Order the variables by the parts that P falls into, and invert each part; 0 unless P is positive
 * definite. */
static int write_parts(active_set *s) {
    const int n = s->n;
    int *order = (int *)s->order, *sizes = (int *)s->sizes, begin = 0, rest = n;
    as_real *block = (as_real *)s->blocks, *G = (as_real *)s->G;
    for (int i = 0; i < n; i++) order[i] = i;
    clear(G, n * n);
    s->widest = 0;
    while (begin < rest) {
        int end = begin + 1;
        for (int k = begin; k < end; k++)
            for (int j = end; j < rest; j++)
                if (s->P[order[k] * n + order[j]] != 0) swap(order + end++, order + j);
        const int size = sizes[begin] = end - begin, *part = order + begin;
        for (int k = 0; k < size; k++)
            for (int j = k; j < size; j++) block[k * size + j] = s->P[part[k] * n + part[j]];
        if (!invert(block, size)) return 0;
        for (int k = 0; k < size; k++) {
            for (int j = 0; j < size; j++) G[part[k] * n + part[j]] = block[k * size + j];
            s->widest = larger(s->widest, sum_of_sizes(block + k * size, size));
        }
        if (size == 1) swap(order + begin, order + --rest);
        else {
            block += size * size;
            begin = end;
        }
    }
    s->coupled = begin;
    return 1;
}

int active_set_factorise(active_set *s, const as_real *P, const as_real *A) {
    const int n = s->n;
    as_real *own = (as_real *)s->P;
    s->steepest = 0;
    for (int i = 0; i < n; i++)
        for (int c = 0; c <= i; c++)
            own[i * n + c] = own[c * n + i] = (P[i * n + c] + P[c * n + i]) / 2;
    for (int i = 0; i < n; i++) {
        const as_real sum = sum_of_sizes(own + i * n, n);
        if (is_infinite(sum)) return ACTIVE_SET_DATA_NOT_FINITE;
        s->steepest = larger(s->steepest, sum);
    }
    if (!write_parts(s)) return ACTIVE_SET_NOT_DEFINITE;
    measure_loss(s);
    return active_set_replace_rows(s, A);
}
