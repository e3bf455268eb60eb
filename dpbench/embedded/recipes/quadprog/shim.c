/* quadprog: Cᵀz ≥ b, equalities first, then upper and lower limits of rows, then of bounds. */

#include <math.h>

#include "embedded.h"
#include "problem.h"

int cholesky(int n, double a[]);
void triangular_invert(int n, double a[]);
int qpgen2_(double *G, double *av, int n, double *xv, double *lagr, double *obj, double *C,
    double *bv, int q, int meq, int *iact, int *nact, int *iter, double *work, int factorized);

static double inverse[N * N], G[N * N], a[N], C[N * SIDES], b[SIDES], lagr[SIDES];
static double work[2 * N + 2 * SIDES + N * (N + 5) / 2];
static int active[SIDES];
static int sides, equalities, code[SIDES]; /* ±(row + 1) of each column; rows of A, then bounds */

static double limit(const embedded_qp *qp, int i, int upper) {
    if (i < M) return upper ? qp->u[i] : qp->l[i];
    return upper ? qp->ub[i - M] : qp->lb[i - M];
}

static void add_side(const embedded_qp *qp, int i, int side) {
    for (int c = 0; c < N; c++) {
        const double x = i < M ? qp->A[i * N + c] : i - M == c;
        C[sides * N + c] = side > 0 ? -x : x;
    }
    code[sides++] = side * (i + 1);
}

/* The columns of rows or bounds: upper limits, then lower ones. */
static void add_sides(const embedded_qp *qp, int from, int to) {
    for (int side = 1; side >= -1; side -= 2)
        for (int i = from; i < to; i++)
            if (limit(qp, i, 1) != limit(qp, i, 0) && fabs(limit(qp, i, side > 0)) < INFINITY)
                add_side(qp, i, side);
}

static int write_matrices(const embedded_qp *qp) {
    for (int i = 0; i < N * N; i++) inverse[i] = qp->P[i];
    if (cholesky(N, inverse)) return 2;
    triangular_invert(N, inverse);
    sides = 0;
    for (int i = 0; i < M + N; i++)
        if (limit(qp, i, 1) == limit(qp, i, 0)) add_side(qp, i, -1);
    equalities = sides;
    add_sides(qp, 0, M);
    add_sides(qp, M, M + N);
    return 0;
}

static int count_sides(const real *low, const real *high, int n) {
    int count = 0;
    for (int i = 0; i < n; i++)
        count += low[i] == high[i] ? 1 : (low[i] > -INFINITY) + (high[i] < INFINITY);
    return count;
}

/* Whether a row has become an equality, or lost or got a limit. */
static int is_other_pattern(const embedded_qp *qp) {
    for (int k = 0; k < sides; k++) {
        const int i = (code[k] > 0 ? code[k] : -code[k]) - 1;
        if (fabs(limit(qp, i, code[k] > 0)) == INFINITY) return 1;
        if ((limit(qp, i, 1) == limit(qp, i, 0)) != (k < equalities)) return 1;
    }
    return count_sides(qp->l, qp->u, M) + count_sides(qp->lb, qp->ub, N) != sides;
}

int embedded_set_up(embedded_qp *qp) { return write_matrices(qp); }

int embedded_step(embedded_qp *qp) {
    double objective;
    int count, iterations[2];
    if (qp->changed || is_other_pattern(qp))
        if (write_matrices(qp)) return qp->status = 2;
    for (int i = 0; i < N * N; i++) G[i] = inverse[i];
    for (int i = 0; i < N; i++) a[i] = -qp->q[i];
    for (int k = 0; k < sides; k++)
        b[k] = code[k] > 0 ? -limit(qp, code[k] - 1, 1) : limit(qp, -code[k] - 1, 0);
    qp->status = qpgen2_(G, a, N, qp->z, lagr, &objective, C, b, sides, equalities, active, &count,
        iterations, work, 1);
    qp->iterations = iterations[0];
    qp->active = count;
    return qp->status;
}
