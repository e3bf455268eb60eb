/* QOCO: its generated workspace; upper limits, then lower ones, equalities apart. */

#include "embedded.h"
#include "problem.h"
#include "qoco_custom.h"
#include "rows.h"

static Workspace work;

static double limit(const embedded_qp *qp, int i, int is_upper) {
    if (i < M) return is_upper ? qp->u[i] : qp->l[i];
    return is_upper ? qp->ub[i - M] : qp->lb[i - M];
}

int embedded_set_up(embedded_qp *qp) {
    (void)qp;
    set_default_settings(&work);
    work.settings.abstol = SETTING_ABSTOL;
    work.settings.reltol = SETTING_RELTOL;
    load_data(&work);
    return 0;
}

int embedded_step(embedded_qp *qp) {
    update_c(&work, qp->q);
    for (int k = 0; k < equal_rows; k++) work.b[k] = limit(qp, equal[k], 1);
    for (int k = 0; k < upper_rows; k++) work.h[k] = limit(qp, upper[k], 1);
    for (int k = 0; k < lower_rows; k++) work.h[upper_rows + k] = -limit(qp, lower[k], 0);
    qoco_custom_solve(&work);
    for (int i = 0; i < N; i++) qp->z[i] = work.sol.x[i];
    qp->iterations = work.sol.iters;
    return qp->status = work.sol.status == QOCO_CUSTOM_SOLVED ? 0 : (int)work.sol.status;
}
