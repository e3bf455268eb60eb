/* The paper's active-set method (dpbench/solvers/own/active_set.h). */

#include "active_set_step.h"

int embedded_step(embedded_qp *qp) {
    take(qp);
    const int ending = active_set_solve(&s);
    give(qp);
    qp->iterations = s.iterations;
    qp->active = s.count;
    return qp->status = ending < 0 ? ending : 0;
}
