/* qpOASES: P and A row by row in the caller's memory; bounds apart from rows. */

#include <qpOASES.hpp>

#include "embedded.h"
#include "problem.h"

static qpOASES::SQProblem problem(N, M);
static int is_ready;

static qpOASES::returnValue start(embedded_qp *qp, qpOASES::int_t *iterations) {
    problem.reset();
    *iterations = SETTING_MAX_ITER;
    return problem.init(qp->P, qp->q, qp->A, qp->lb, qp->ub, qp->l, qp->u, *iterations);
}

static qpOASES::returnValue go_on(embedded_qp *qp, qpOASES::int_t *iterations) {
    *iterations = SETTING_MAX_ITER;
    if (qp->changed)
        return problem.hotstart(qp->P, qp->q, qp->A, qp->lb, qp->ub, qp->l, qp->u, *iterations);
    return problem.hotstart(qp->q, qp->lb, qp->ub, qp->l, qp->u, *iterations);
}

int embedded_set_up(embedded_qp *qp) {
    embedded_construct();
    qpOASES::Options options;
    options.setToMPC();
    options.printLevel = qpOASES::PL_NONE;
    problem.setOptions(options);
    (void)qp;
    return 0;
}

int embedded_step(embedded_qp *qp) {
    qpOASES::int_t iterations, lost = 0;
    qpOASES::returnValue ending = qpOASES::RET_INIT_FAILED;
    if (is_ready) ending = go_on(qp, &iterations);
    if (ending != qpOASES::SUCCESSFUL_RETURN) {
        lost = is_ready ? iterations : 0;
        ending = start(qp, &iterations);
    }
    is_ready = ending == qpOASES::SUCCESSFUL_RETURN;
    problem.getPrimalSolution(qp->z);
    qp->iterations = lost + iterations;
    qp->active = problem.getNFX() + problem.getNAC();
    return qp->status = ending;
}
