/* What a step of both solvers of dpbench/solvers/own does beside the solve. */

#ifndef ACTIVE_SET_STEP_H
#define ACTIVE_SET_STEP_H

#include "active_set.h"
#include "constants.h"
#include "embedded.h"
#include "problem.h"

#ifdef SCALARS
static active_set s = {.n = N, .m = M, .P = P_, .G = G_, .unit = unit_, .a = a_,
    .column = column_, .first = first_, .parent = parent_, .rest = rest_,
    .order = order_, .sizes = sizes_, .blocks = blocks_, SCALARS};
static as_real reals[ACTIVE_SET_STEP_REALS(N, M)];
static int integers[ACTIVE_SET_STEP_INTEGERS(N, M)];
#else
static active_set s;
static as_real reals[ACTIVE_SET_REALS(N, M)];
static int integers[ACTIVE_SET_INTEGERS(N, M)];
#endif

static void copy(real *to, const real *from, int n) {
    for (int i = 0; i < n; i++) to[i] = from[i];
}

/* Rarely called: not copied into its callers. */
__attribute__((noinline, cold)) static void take_bounds(const embedded_qp *qp) {
    copy(s.low, qp->lb, N);
    copy(s.high, qp->ub, N);
}

int embedded_set_up(embedded_qp *qp) {
#ifdef SCALARS
    active_set_place_step(&s, reals, integers);
#if SETTING_REFINE /* hildreth has no such setting: 0 */
    active_set_let_refine(&s);
#endif
    const int refused = 0;
#else
    active_set_place(&s, N, M, reals, integers);
    const int refused = active_set_factorise(&s, qp->P, qp->A);
#endif
    s.warm = 1;
    s.block = BLOCK;
    take_bounds(qp);
    return refused;
}

static void take(embedded_qp *qp) {
    s.q = qp->q;
    copy(s.low + N, qp->l, M);
    copy(s.high + N, qp->u, M);
    if (!qp->changed) return;
    take_bounds(qp);
#ifndef SCALARS
    active_set_factorise(&s, qp->P, qp->A);
#endif
}

static void give(embedded_qp *qp) { copy(qp->z, s.z, N); }

#endif
