/* DAQP: bounds first, then rows; memory is taken once, at set-up. */

#include "api.h"
#include "embedded.h"
#include "problem.h"
#include "utils.h"

static DAQPWorkspace work;
static DAQPProblem problem;
static real f[N], low[N + M], high[N + M], lam[N + M];
static int sense[N + M];
#if CHANGES
static real H[N * N], A[M * N];
#endif

static void copy(real *to, const real *from, int n) {
    for (int i = 0; i < n; i++) to[i] = from[i];
}

static void take(const embedded_qp *qp) {
    copy(f, qp->q, N);
    copy(low + N, qp->l, M);
    copy(high + N, qp->u, M);
}

static void take_all(const embedded_qp *qp) {
    take(qp);
    copy(low, qp->lb, N);
    copy(high, qp->ub, N);
#if CHANGES
    copy(H, qp->P, N * N);
    copy(A, qp->A, M * N);
    problem.H = H;
    problem.A = A;
#endif
}

int embedded_set_up(embedded_qp *qp) {
    problem = (DAQPProblem){.n = N, .m = N + M, .ms = N, .H = qp->P, .f = f, .A = qp->A};
    problem.bupper = high;
    problem.blower = low;
    problem.sense = sense;
    take_all(qp);
    const int flag = setup_daqp(&problem, &work, 0);
    return flag < 0 ? flag : 0;
}

int embedded_step(embedded_qp *qp) {
    DAQPResult result = {.x = qp->z, .lam = lam};
    int changed = DAQP_UPDATE_v + DAQP_UPDATE_d;
    if (qp->changed) {
        take_all(qp);
        problem.sense = work.sense;
        changed += DAQP_UPDATE_Rinv + DAQP_UPDATE_M + DAQP_UPDATE_sense;
    } else {
        take(qp);
    }
    const int flag = daqp_update_ldp(changed, &work, &problem);
    if (flag < 0) return qp->status = flag;
    daqp_solve(&result, &work);
    qp->iterations = result.iter;
    qp->active = work.n_active;
    return qp->status = result.exitflag == 1 || result.exitflag == 2 ? 0 : result.exitflag;
}
