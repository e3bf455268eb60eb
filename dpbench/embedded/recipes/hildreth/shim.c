/* Hildreth's procedure (dpbench/solvers/own/hildreth.c), on the memory of the active-set method. */

#include "active_set_step.h"

int hildreth_solve(
    active_set *s, int max_iter, as_real eps_change, as_real eps_row, as_real *change);

static as_real change[N + M];

int embedded_step(embedded_qp *qp) {
    take(qp);
    const int ending =
        hildreth_solve(&s, SETTING_MAX_ITER, SETTING_EPS_CHANGE, SETTING_EPS_ROW, change);
    give(qp);
    qp->iterations = s.iterations;
    return qp->status = ending < 0 ? ending : 0;
}
