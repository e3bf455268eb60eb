/* OSQP: its generated workspace; rows, then bounds. */

#include "embedded.h"
#include "osqp.h"
#include "problem.h"
#include "workspace.h"

static real low[M + N], high[M + N];

static real clip(real x) { return x > OSQP_INFTY ? OSQP_INFTY : x < -OSQP_INFTY ? -OSQP_INFTY : x; }

int embedded_set_up(embedded_qp *qp) {
    for (int i = 0; i < N; i++) {
        low[M + i] = clip(qp->lb[i]);
        high[M + i] = clip(qp->ub[i]);
    }
    return 0;
}

int embedded_step(embedded_qp *qp) {
    for (int i = 0; i < M; i++) {
        low[i] = clip(qp->l[i]);
        high[i] = clip(qp->u[i]);
    }
    const OSQPInt refused = osqp_update_data_vec(&solver, qp->q, low, high);
    if (refused) return qp->status = (int)refused;
    osqp_solve(&solver);
    for (int i = 0; i < N; i++) qp->z[i] = solver.solution->x[i];
    qp->iterations = (int)solver.info->iter;
    return qp->status = solver.info->status_val == OSQP_SOLVED ? 0 : (int)solver.info->status_val;
}
