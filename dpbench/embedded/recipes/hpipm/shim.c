/* HPIPM: its dense QP with bounds on all variables; limits that are infinite are masked. */

#include <math.h>
#include <stdlib.h>

#include "embedded.h"
#include "problem.h"

#include "hpipm_d_dense_qp_dim.h"
#include "hpipm_d_dense_qp.h"
#include "hpipm_d_dense_qp_ipm.h"
#include "hpipm_d_dense_qp_sol.h"

static struct d_dense_qp_dim dim;
static struct d_dense_qp problem;
static struct d_dense_qp_sol solution;
static struct d_dense_qp_ipm_arg options;
static struct d_dense_qp_ipm_ws work;
static double C[N * M + 1], value[N + M + 1], mask[N + M + 1];
static int index[N];

typedef void setter(double *values, struct d_dense_qp *qp);

static void set_limits(const real *limits, int n, setter *set, setter *set_mask) {
    for (int i = 0; i < n; i++) {
        mask[i] = fabs(limits[i]) < INFINITY;
        value[i] = mask[i] != 0 ? limits[i] : 0;
    }
    set(value, &problem);
    set_mask(mask, &problem);
}

static void take_matrices(embedded_qp *qp) {
    for (int i = 0; i < M; i++)
        for (int j = 0; j < N; j++) C[j * M + i] = qp->A[i * N + j];
    d_dense_qp_set_H(qp->P, &problem);
    d_dense_qp_set_C(C, &problem);
    set_limits(qp->lb, N, d_dense_qp_set_lb, d_dense_qp_set_lb_mask);
    set_limits(qp->ub, N, d_dense_qp_set_ub, d_dense_qp_set_ub_mask);
}

int embedded_set_up(embedded_qp *qp) {
    int iterations = SETTING_MAX_ITER;
    double tolerance = SETTING_TOL;
    d_dense_qp_dim_create(&dim, malloc(d_dense_qp_dim_memsize()));
    d_dense_qp_dim_set_nv(N, &dim);
    d_dense_qp_dim_set_ne(0, &dim);
    d_dense_qp_dim_set_nb(N, &dim);
    d_dense_qp_dim_set_ng(M, &dim);
    d_dense_qp_dim_set_ns(0, &dim);
    d_dense_qp_create(&dim, &problem, malloc(d_dense_qp_memsize(&dim)));
    d_dense_qp_sol_create(&dim, &solution, malloc(d_dense_qp_sol_memsize(&dim)));
    d_dense_qp_ipm_arg_create(&dim, &options, malloc(d_dense_qp_ipm_arg_memsize(&dim)));
    d_dense_qp_ipm_arg_set_default(SPEED, &options);
    d_dense_qp_ipm_arg_set_iter_max(&iterations, &options);
    d_dense_qp_ipm_arg_set_tol_stat(&tolerance, &options);
    d_dense_qp_ipm_arg_set_tol_ineq(&tolerance, &options);
    d_dense_qp_ipm_arg_set_tol_comp(&tolerance, &options);
    d_dense_qp_ipm_ws_create(
        &dim, &options, &work, malloc(d_dense_qp_ipm_ws_memsize(&dim, &options)));
    for (int i = 0; i < N; i++) index[i] = i;
    d_dense_qp_set_idxb(index, &problem);
    take_matrices(qp);
    return 0;
}

int embedded_step(embedded_qp *qp) {
    if (qp->changed) take_matrices(qp);
    d_dense_qp_set_g(qp->q, &problem);
    set_limits(qp->l, M, d_dense_qp_set_lg, d_dense_qp_set_lg_mask);
    set_limits(qp->u, M, d_dense_qp_set_ug, d_dense_qp_set_ug_mask);
    d_dense_qp_ipm_solve(&problem, &solution, &options, &work);
    d_dense_qp_sol_get_v(&solution, qp->z);
    d_dense_qp_ipm_get_iter(&work, &qp->iterations);
    d_dense_qp_ipm_get_status(&work, &qp->status);
    return qp->status;
}
