/* PIQP: its dense solver; rows of A as inequalities, bounds apart. */

#include <piqp/piqp.hpp>

#include "embedded.h"
#include "problem.h"

typedef Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> Rows;
typedef Eigen::Map<const Rows> Matrix;
typedef Eigen::Map<const Eigen::VectorXd> Vector;

static piqp::DenseSolver<double> solver;
static Eigen::MatrixXd P, G;

static void take_matrices(const embedded_qp *qp) {
    P = Matrix(qp->P, N, N);
    G = Matrix(qp->A, M, N);
}

int embedded_set_up(embedded_qp *qp) {
    embedded_construct();
    take_matrices(qp);
    solver.setup(P, Vector(qp->q, N), piqp::nullopt, piqp::nullopt, G, Vector(qp->l, M),
        Vector(qp->u, M), Vector(qp->lb, N), Vector(qp->ub, N));
    return 0;
}

int embedded_step(embedded_qp *qp) {
    const Vector q(qp->q, N), l(qp->l, M), u(qp->u, M);
    if (qp->changed) {
        take_matrices(qp);
        solver.update(
            P, q, piqp::nullopt, piqp::nullopt, G, l, u, Vector(qp->lb, N), Vector(qp->ub, N));
    } else {
        solver.update(piqp::nullopt, q, piqp::nullopt, piqp::nullopt, piqp::nullopt, l, u);
    }
    const piqp::Status ending = solver.solve();
    for (int i = 0; i < N; i++) qp->z[i] = solver.result().x[i];
    qp->iterations = static_cast<int>(solver.result().info.iter);
    return qp->status = ending == piqp::PIQP_SOLVED ? 0 : ending;
}
