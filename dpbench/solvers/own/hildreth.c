/* Hildreth's quadratic programming procedure, on the problem of active_set.h.
 *
 * C. Hildreth, "A quadratic programming procedure", Naval Research Logistics Quarterly 4 (1957)
 * 79-85, in the form of L. Wang, Model Predictive Control System Design and Implementation Using
 * MATLAB (Springer 2009), section 2.4.4, but with one multiplier of either sign for the two limits
 * of a row. The multipliers are visited one after the other, and each is set to the value that is
 * best while the others stay:
 *
 *     own = c_iᵀz + H_ii λ_i
 *     λ_i = (own − high_i)/H_ii if own > high_i,  (own − low_i)/H_ii if own < low_i,  else 0
 *
 * By hand, the point nearest (2, 2) under z₀ ≤ ½ and z₀ + z₁ ≤ 2, rows 0 and 2 of C:
 *
 *     sweep    row 0: λ₀ so that z₀ = ½      row 2: λ₂ so that z₀ + z₁ = 2      z = (2, 2) − Cᵀλ
 *     1        2 − ½          = 1.5          (½ + 2 − 2)/2         = 0.25       (0.25, 1.75)
 *     2        0.25 + 1.5 − ½ = 1.25         (½ + 1.75 + ½ − 2)/2  = 0.375      (0.375, 1.625)
 *     k        1 + 2^−k                      ½ − 2^−(k+1)                       → (½, 1.5)
 */

/* One unit of compilation: the functions of the active-set method serve here too. */
#include "active_set_setup.c"

/* z := base − Σ λ_i P⁻¹c_i over all rows, and their values behind it */
static void write_all(active_set *s) {
    for (int c = 0; c < s->n; c++) s->z[c] = s->base[c];
    for (int i = 0; i < s->n + s->m; i++)
        if (s->lam[i] != 0) add_scaled(s->z, -s->lam[i], inverse_row(s, i), s->n);
    write_row_values(s);
}

/* Visit each row once; returns ‖Δλ‖² and the most that a row was moved by. */
static as_real sweep(active_set *s, as_real *change, as_real *moved) {
    as_real square = 0;
    *moved = 0;
    for (int i = 0; i < s->n + s->m; i++) {
        const as_real h = entry(s, i, i);
        change[i] = 0;
        if (!(h > 0)) continue;
        const as_real own = row_times(s, i, s->z) + h * s->lam[i];
        const as_real g = own > s->high[i] ? s->high[i] : own < s->low[i] ? s->low[i] : own;
        const as_real d = (own - g) / h - s->lam[i];
        if (d == 0) continue;
        s->lam[i] += d;
        change[i] = d;
        add_scaled(s->z, -d, inverse_row(s, i), s->n);
        square += d * d;
        *moved = larger(*moved, size_of(d) * h);
    }
    return square;
}

/* A row of zeros whose limits exclude 0 is its own proof. */
static int find_impossible(active_set *s) {
    for (int i = s->n; i < s->n + s->m; i++) {
        if (s->first[i - s->n] < s->first[i - s->n + 1] || !(s->low[i] > 0 || s->high[i] < 0))
            continue;
        clear(s->lam, s->n + s->m);
        s->lam[i] = s->high[i] < 0 ? 1 : -1;
        return 1;
    }
    return 0;
}

/* Exchange λ and its change, which is a proof where λ grows along a ray. */
static void exchange(active_set *s, as_real *change) {
    for (int i = 0; i < s->n + s->m; i++) {
        const as_real lam = s->lam[i];
        s->lam[i] = change[i];
        change[i] = lam;
    }
}

/* Sweep until ‖Δλ‖² < eps_change and no row moves by more than eps_row. Returns the sweeps, or what
 * active_set_solve does; INACCURATE after max_iter sweeps. `change`: n+m, scratch. */
int hildreth_solve(
    active_set *s, int max_iter, as_real eps_change, as_real eps_row, as_real *change) {
    const int n = s->n, N = n + s->m;
    int converged = 0;
    as_real moved = 0;
    if (is_infinite(write_base(s))) return ACTIVE_SET_NOT_FINITE;
    for (int i = 0; i < N; i++)
        if (has_crossed_limits(s, i)) return ACTIVE_SET_CROSSED;
    if (s->stale || !s->warm) clear(s->lam, N);
    for (int i = 0; i < n - s->block; i++) s->lam[i] = s->lam[i + s->block];
    for (int i = n; i < N - s->m * s->block / n; i++) s->lam[i] = s->lam[i + s->m * s->block / n];
    s->iterations = 0;
    s->stale = 1;
    if (find_impossible(s)) return ACTIVE_SET_INFEASIBLE;
    write_all(s);
    while (!converged && s->iterations < max_iter) {
        converged = sweep(s, change, &moved) < eps_change && moved <= eps_row;
        s->iterations++;
    }
    if (!converged) {
        exchange(s, change);
        if (active_set_is_proof(s)) return ACTIVE_SET_INFEASIBLE;
        exchange(s, change);
    }
    write_all(s);
    s->stale = 0;
    return converged ? s->iterations : ACTIVE_SET_INACCURATE;
}
