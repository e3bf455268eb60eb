/* Refinement and proofs of the active-set method, for answers that rounding could decide.
 *
 * Where rounding in P⁻¹ could have moved the gradient (`loss`) or an active row from its limit, the
 * answer is refined in the problem's own data, P δz + C_Wᵀδλ = −(P z + q + Cᵀλ) and
 * C_W δz = g − C_W z, and checked. Where more rows meet than are active, or rows are nearly
 * parallel, rounding could decide the set: there the residuals are summed in twice the precision,
 * and the method goes on until no row is violated by more than that leaves. What it cannot decide
 * even so is INACCURATE. */

/* One unit of compilation, as in active_set_setup.c. */
#include "active_set.c"

#ifdef FOR_SIZE
#pragma clang attribute push(__attribute__((cold, minsize)), apply_to = function)
#endif

#define CONTRADICTION ROUNDING_OF(1e-9) /* no rounding is above this share of refined values */
#define STEEP REAL(1e-4)                /* an active row nearer to the others leans on them */
#define LOST ROUNDING_OF(3e-8)          /* a gradient that rounding changed by less needs no refinement */
#define SETTLED ROUNDING_OF(1e-12)      /* a smaller correction leaves nothing to correct */
#define EXACT (EPSILON * REAL(1e-3))    /* a correction that the doubled precision has to reach */

static as_real smaller(as_real x, as_real y) { return x < y ? x : y; }

/* ---- refinement and check ------------------------------------------------------------------ */

/* out += P x: whole rows for variables that P couples, else the diagonal */
static void add_product(const active_set *s, as_real *out, const as_real *x) {
    const int n = s->n;
    add_rows(out, 1, s->P, x, s->order, s->coupled, n);
    for (int k = s->coupled; k < n; k++) out[s->order[k]] += x[s->order[k]] * s->P[s->order[k] * (n + 1)];
}

/* r := P z + q + Cᵀλ; returns zᵀP z */
static as_real write_gradient(active_set *s) {
    const int n = s->n;
    for (int c = 0; c < n; c++) s->r[c] = 0;
    add_product(s, s->r, s->z);
    const as_real square = dot(s->r, s->z, n);
    for (int c = 0; c < n; c++) s->r[c] += s->q[c];
    for (int k = 0; k < s->count; k++) add_row(s, s->active[k], s->lam[s->active[k]], s->r);
    return larger(square, 0);
}

/* Correct z and λ once on the active rows; returns the square of the correction in the norm of P,
 * r ≈ P e and T = C_W (z + e) − g given: eᵀP e + δλᵀ H_WW δλ. */
static as_real correct(active_set *s, as_real *restrict z_low, as_real *restrict lam_low) {
    const int w = s->count;
    as_real square = -dot(s->e, s->r, s->n);
    for (int k = 0; k < w; k++) s->R[k] = s->T[k];
    substitute_forward(s->L, s->R, w);
    substitute_backward(s->L, s->R, w);
    square += dot(s->R, s->T, w);
    for (int k = 0; k < w; k++) add_scaled(s->e, -s->R[k], inverse_row(s, s->active[k]), s->n);
    for (int c = 0; c < s->n; c++) {
        const as_real more = s->e[c] + z_low[c], sum = s->z[c] + more;
        z_low[c] = more - (sum - s->z[c]);
        s->z[c] = sum;
    }
    for (int k = 0; k < w; k++) {
        as_real *lam = s->lam + s->active[k];
        const as_real more = s->R[k] + lam_low[k], sum = *lam + more;
        lam_low[k] = more - (sum - *lam);
        *lam = sum;
    }
    return larger(square, 0);
}

/* Refine the answer once where its residual asks for it; `size` := ‖z‖ in the norm of P. */
static as_real refine(active_set *s, as_real *size) {
    const int n = s->n;
    as_real off = 0;
    *size = root(write_gradient(s));
    clear(s->e, n);
    clear(s->z_low, n);
    clear(s->lam_low, n);
    if (largest_of(s->r, n) > REAL(64) * EPSILON * (1 + largest_of(s->q, n))) {
        off = 1;
        multiply_inverse(s, s->e, -1, s->r);
    }
    for (int k = 0; k < s->count; k++) {
        const int i = s->active[k];
        s->T[k] = row_times(s, i, s->z) + row_times(s, i, s->e) - limit_of(s, i);
    }
    if (off == 0 && s->count == 0) return 0;
    const as_real square = correct(s, s->z_low, s->lam_low);
    write_row_values(s);
    return square;
}

/* Zero wrong signs within rounding, drop the rows of others; returns how many. */
static int correct_signs(active_set *s, as_real rounding) {
    int dropped = 0;
    for (int k = s->count - 1; k >= 0; k--) {
        const int i = s->active[k];
        if (!has_wrong_sign(s, i, s->lam[i])) continue;
        if (size_of(s->lam[i]) <= rounding * s->unit[i]) s->lam[i] = 0;
        else {
            drop_row(s, k);
            dropped++;
        }
    }
    return dropped;
}

/* Σ |a_c x_c| over the entries of row i of C */
static as_real row_terms(const active_set *s, int i, const as_real *x) {
    if (i < s->n) return size_of(x[i]);
    as_real sum = 0;
    for (int e = s->first[i - s->n]; e < s->first[i - s->n + 1]; e++)
        sum += size_of(s->a[e] * x[s->column[e]]);
    return sum;
}

/* The largest of: a row beyond a limit; |λ_i| times the distance from the limit that it names; the
 * gradient r; and √((P⁻¹)_ii |r|ᵀ|P⁻¹||r|), by which z_i may miss the optimum on the active rows, each
 * over what is allowed of the terms it is computed from. */
as_real active_set_excess(active_set *s) {
    const int n = s->n;
    const as_real cost = largest_of(s->q, n);
    as_real most = 0, widest = 0, square = 0;
    write_row_values(s);
    write_gradient(s);
    for (int i = 0; i < n; i++) s->e[i] = size_of(s->q[i]) + size_of(s->lam[i]);
    for (int i = 0; i < n + s->m; i++) {
        const as_real v = s->z[i], lam = s->lam[i], beyond = larger(v - s->high[i], s->low[i] - v);
        const as_real terms = VIOLATED * row_terms(s, i, s->z);
        if (beyond > 0) {
            const as_real rounding = terms + VIOLATED * size_of(v);
            most = larger(
                most, beyond / smaller(2 * rounding + SMALL * REAL(1e-3), ROUNDING_OF(2e-7)));
        }
        if (lam == 0) continue;
        const as_real g = lam > 0 ? s->high[i] : s->low[i], slack = size_of(v - g);
        if (is_infinite(g)) return 1 / TINY;
        if (slack > terms + VIOLATED * size_of(g))
            most = larger(most, size_of(lam) * slack / ROUNDING_OF(1e-7));
        for (int e = i < n ? 0 : s->first[i - n]; i >= n && e < s->first[i - n + 1]; e++)
            s->e[s->column[e]] += size_of(lam * s->a[e]);
    }
    for (int i = 0; i < n; i++) {
        const as_real *P = s->P + (size_t)i * (size_t)n, r = size_of(s->r[i]);
        for (int c = 0; c < n; c++) s->e[i] += size_of(P[c] * s->z[c]);
        const as_real rounding = EPSILON * s->e[i], room = (s->high[i] - s->low[i]) / 2;
        if (is_infinite(r)) return 1 / TINY;
        most = larger(most, r / larger(ROUNDING_OF(5e-9) * (1 + cost), rounding));
        most = larger(most, (r + rounding / 2) / (ROUNDING_OF(9e-7) * (1 + cost)));
        s->e[i] = r + rounding;
        const as_real unit = room > 1 && !is_infinite(room) ? room : 1;
        widest = larger(widest, inverse_row(s, i)[i] / (unit * unit));
    }
    for (int i = 0; i < n; i++)
        for (int c = 0; c < n; c++) square += s->e[i] * size_of(inverse_row(s, i)[c]) * s->e[c];
    return larger(most, root(widest * square) / ROUNDING_OF(5e-7));
}

/* Whether lam, a ray, proves that no z keeps the limits: Cᵀlam = 0 and the most that the limits let
 * lamᵀC z reach is negative, each by more than rounding. What does not cancel in a column is left to
 * the bound of that variable or, where there is none, may not reach 0 within 1e6 of the limits. */
int active_set_is_proof(active_set *s) {
    const int n = s->n;
    as_real *box = s->r, *terms = s->e;
    as_real reach = 0, size = 0, unbounded = 0, most = TINY;
    for (int c = 0; c < n; c++) {
        box[c] = 0;
        terms[c] = size_of(s->lam[c]);
    }
    for (int i = n; i < n + s->m; i++)
        for (int e = s->first[i - n]; e < s->first[i - n + 1] && s->lam[i] != 0; e++) {
            box[s->column[e]] -= s->lam[i] * s->a[e];
            terms[s->column[e]] += size_of(s->lam[i] * s->a[e]);
        }
    for (int i = 0; i < n + s->m; i++) {
        as_real by = s->lam[i];
        if (i < n) {
            if (!(size_of(box[i] - by) <= ROUNDING_OF(1e-6) * terms[i])) return 0;
            most = larger(most, terms[i]);
            by = box[i];
        }
        if (by == 0) continue;
        const as_real g = by > 0 ? s->high[i] : s->low[i];
        if (is_infinite(g) && i < n) unbounded += size_of(by);
        else {
            reach += by * g;
            size += size_of(by * g);
        }
    }
    return reach < -(ROUNDING_OF(1e-10) + REAL(1e6) * unbounded / most) * size;
}

/* How a search ended that found a contradiction: infeasible if λ proves it, else with λ as before. */
static int prove(active_set *s) {
    if (active_set_is_proof(s)) return ACTIVE_SET_INFEASIBLE;
    for (int i = 0; i < s->n + s->m; i++)
        if (s->side[i] != 1 && s->side[i] != -1) s->lam[i] = 0;
    for (int k = 0; k < s->count; k++) s->lam[s->active[k]] = s->T[k];
    return DOUBTFUL;
}

/* ‖z‖ in the norm of P by zᵀ(P z + q + Cᵀλ) = 0 */
static as_real length_of_point(const active_set *s) {
    as_real square = -dot(s->q, s->z, s->n);
    for (int k = 0; k < s->count; k++)
        square -= s->lam[s->active[k]] * s->z[s->active[k]];
    return root(larger(square, 0));
}

/* Whether active rows are nearly dependent. */
static int is_steep(active_set *s) {
    for (int k = 0; k < s->count; k++)
        if (factor_row(s, k)[k] * STEEP > s->unit[s->active[k]]) return 1;
    return 0;
}

/* ---- twice the precision ------------------------------------------------------------------- */

/* high + low += a b, without rounding of the product (Dekker 1971; Ogita, Rump and Oishi 2005) */
static void add_exactly(as_real *high, as_real *low, as_real a, as_real b) {
    const as_real p = a * b, as = SPLITTER * a, bs = SPLITTER * b;
    const as_real ah = as - (as - a), al = a - ah, bh = bs - (bs - b), bl = b - bh;
    const as_real e = al * bl - (((p - ah * bh) - al * bh) - ah * bl);
    const as_real sum = *high + p, part = sum - *high;
    *low += e + ((*high - (sum - part)) + (p - part));
    *high = sum;
}

/* c_iᵀ(z + z_low) − g */
static as_real exact_distance(const active_set *s, int i, as_real g) {
    as_real high = -g, low = 0;
    if (i < s->n) {
        add_exactly(&high, &low, 1, s->z[i]);
        return high + (low + s->z_low[i]);
    }
    for (int e = s->first[i - s->n]; e < s->first[i - s->n + 1]; e++) {
        add_exactly(&high, &low, s->a[e], s->z[s->column[e]]);
        low += s->a[e] * s->z_low[s->column[e]];
    }
    return high + low;
}

/* Refine z + z_low and λ on the active rows by exact residuals, as long as corrections fall and are
 * above `enough`; returns the last one in the norm of P. */
static as_real polish(active_set *s, as_real enough) {
    const int n = s->n;
    as_real before = 1 / TINY;
    clear(s->z_low, n);
    clear(s->lam_low, n);
    for (int pass = 0; pass < POLISHES; pass++) {
        for (int c = 0; c < n; c++) {
            const as_real *P = s->P + (size_t)c * (size_t)n;
            as_real high = s->q[c], low = dot(P, s->z_low, n);
            for (int j = 0; j < n; j++) add_exactly(&high, &low, P[j], s->z[j]);
            s->r[c] = high;
            s->r_low[c] = low;
        }
        for (int k = 0; k < s->count; k++) {
            const int i = s->active[k];
            const as_real lam = s->lam[i];
            add_row(s, i, s->lam_low[k], s->r_low);
            if (i < n) add_exactly(s->r + i, s->r_low + i, 1, lam);
            for (int e = i < n ? 0 : s->first[i - n]; i >= n && e < s->first[i - n + 1]; e++)
                add_exactly(s->r + s->column[e], s->r_low + s->column[e], s->a[e], lam);
        }
        add_scaled(s->r, 1, s->r_low, n);
        multiply_inverse(s, s->e, -1, s->r);
        for (int k = 0; k < s->count; k++) {
            const int i = s->active[k];
            s->T[k] = exact_distance(s, i, limit_of(s, i)) + row_times(s, i, s->e);
        }
        const as_real now = root(correct(s, s->z_low, s->lam_low));
        if (!(now < before / 2) || now <= enough) return now;
        before = now;
    }
    return before;
}

/* The row most beyond a limit at z + z_low where that is known to `error`; −1 if none is. */
static int find_exactly(const active_set *s, as_real error, as_real *gap) {
    as_real most = 0;
    int worst = -1;
    for (int i = 0; i < s->n + s->m; i++) {
        if (s->side[i] != NEITHER) continue;
        const as_real over = is_infinite(s->high[i]) ? -1 : exact_distance(s, i, s->high[i]);
        const as_real under = is_infinite(s->low[i]) ? -1 : -exact_distance(s, i, s->low[i]);
        const as_real share = larger(over, under) * s->unit[i];
        if (share > error && share > most) {
            most = share;
            worst = i;
            *gap = over >= under ? over : -under;
        }
    }
    return worst;
}

/* Forget which rows were left out; returns how many were. */
static int readmit(active_set *s) {
    int count = 0;
    for (int i = 0; i < s->n + s->m; i++)
        if (s->side[i] == LEFT_OUT) {
            s->side[i] = NEITHER;
            count++;
        }
    return count;
}

/* Go on from the active set on exact values, where rounding could decide it. A row that leans on the
 * active ones so much that no residual tells whether it contradicts them is left out, until it is
 * violated by more than rounding: what is found then is INACCURATE. */
static int decide_exactly(active_set *s) {
    const int N = s->n + s->m;
    int ending = OPTIMAL, left_out = 0, iterations = s->iterations;
    for (int pass = 0; pass < 4 * N; pass++, iterations += s->iterations) {
        const as_real bare = larger(-dot(s->q, s->base, s->n), 0);
        const as_real error = polish(s, EXACT * root(bare)), size = root(larger(write_gradient(s), bare));
        as_real gap = 0;
        int j = -1;
        s->iterations = 0;
        ending = DOUBTFUL;
        if (error <= EXACT * (size + TINY)) {
            if (correct_signs(s, larger(error, VIOLATED * EPSILON * size)) > 0) continue;
            const as_real least = left_out ? EPSILON * 10 : EPSILON * EPSILON;
            j = find_exactly(s, 4 * error + least * size, &gap);
            if (j < 0 && readmit(s)) j = find_exactly(s, SMALL * size, &gap);
            if (j < 0) ending = OPTIMAL;
            if (j < 0) break;
            const as_real g = gap > 0 ? s->high[j] : s->low[j];
            const as_real allowed = CONTRADICTION * (size_of(g) * s->unit[j] + size);
            write_entries(s, j);
            ending = activate(s, j, gap > 0 ? 1 : -1, size_of(gap), allowed);
            if (ending == CONTRADICTED) ending = prove(s);
            if (ending == ACTIVE_SET_INFEASIBLE) return ending;
        } else if (s->count > 0) {
            j = s->active[s->count - 1];
            drop_row(s, s->count - 1);
        } else break;
        if (ending == OPTIMAL) continue;
        s->side[j] = LEFT_OUT;
        left_out++;
    }
    readmit(s);
    s->iterations = iterations;
    const as_real excess = active_set_excess(s);
    if (!(excess <= REAL(1e4))) return ACTIVE_SET_FAILED;
    return excess <= 1 && ending == OPTIMAL && left_out == 0 ? iterations : ACTIVE_SET_INACCURATE;
}

/* Whether a refined answer is an optimum without a look at all its residuals: by what rounding leaves
 * in a row of length √H_ii, in the gradient, and of that in the variables that are at no bound. */
static int is_clear(const active_set *s, as_real next, as_real size) {
    const as_real row = larger(next, ROUNDING_OF(1e-14) * size) * s->longest;
    as_real terms = s->steepest * largest_of(s->z, s->n), bounds = 0, cost = 0, free = 0;
    for (int k = 0; k < s->count; k++) {
        const as_real lam = size_of(s->lam[s->active[k]]);
        if (s->active[k] < s->n) bounds = larger(bounds, lam);
        else terms += s->largest * lam;
    }
    for (int c = 0; c < s->n; c++) {
        cost = larger(cost, size_of(s->q[c]));
        if (s->side[c] == NEITHER) free = larger(free, size_of(s->q[c]));
    }
    return row <= SMALL && 4 * EPSILON * (terms + bounds + cost) <= SMALL * (1 + cost) &&
        4 * EPSILON * (terms + free) * s->widest <= ROUNDING_OF(5e-7);
}

/* Refine the answer of a search once; DOUBTFUL unless it is an optimum beyond doubt then. */
static int refine_search(active_set *s, as_real reach) {
    as_real size = reach;
    const as_real correction = refine(s, &size), off = root(correction);
    const as_real next = off * smaller(1, off / larger(reach, TINY));
    if (correct_signs(s, larger(VIOLATED * reach, off)) > 0 || next > SETTLED * size) return DOUBTFUL;
    look(s, larger(VIOLATED * size, next), 2 * NEAR * size);
    if (s->found.near || is_steep(s)) return DOUBTFUL;
    return is_clear(s, next, size) || active_set_excess(s) <= 1 ? s->iterations : DOUBTFUL;
}

/* Move z to active bounds that it misses by the rounding of base alone, which is much larger than z
 * where a variable is penalised. */
static void meet_bounds(active_set *s) {
    for (int k = 0; k < s->count; k++) {
        const int i = s->active[k];
        const as_real g = limit_of(s, i);
        if (i < s->n && size_of(s->z[i] - g) <= ON_LIMIT * size_of(s->base[i])) s->z[i] = g;
    }
    write_row_values(s);
}

/* Refine the answer of a search where rounding could decide it, and decide on exact values what is
 * doubtful still. */
static int refine_answer(active_set *s, int ending) {
    const as_real reach = root(larger(-dot(s->q, s->base, s->n), 0));
    if (ending == UNREFINED) {
        meet_bounds(s);
        if (!is_settled(s, reach, s->iterations)) settle(s);
        if (is_settled(s, reach, 1)) ending = s->iterations;
    }
    if (ending >= 0 && !s->found.near && (s->count == 0 || length_of_point(s) <= 2 * reach) &&
        !is_steep(s) && s->loss * largest_of(s->q, s->n) <= LOST)
        return ending;
    if (ending == CONTRADICTED) ending = prove(s);
    if (ending >= 0 || ending == UNREFINED) ending = refine_search(s, reach);
    return ending == DOUBTFUL ? decide_exactly(s) : ending;
}

void active_set_let_refine(active_set *s) { s->refine = refine_answer; }

#ifdef FOR_SIZE
#pragma clang attribute pop
#endif
