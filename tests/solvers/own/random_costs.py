"""Helpers of the tests of dpbench's own solvers."""

import numpy as np

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.library import Problem, load_own_c_library
from tests.solvers.conftest import solve_qp

INF = np.inf


def solve(qp, settings="default", policy="fresh", solver="paper_active_set") -> Solution:
    return solve_qp(open_workspace(solver, policy=policy, settings=settings), qp)


def cost(rng, n, condition=None):
    """Return a symmetric P with eigenvalues from 1 to `condition`, of up to 1e8 at random."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    condition = condition or 10.0 ** rng.uniform(0, 8)
    P = (Q * np.geomspace(1.0, condition, n)) @ Q.T
    return 0.5 * (P + P.T)


def unlimited(P, q, A, low, high) -> QuadraticProgram:
    free = np.full(len(q), INF)
    return QuadraticProgram(P, q, A, low, high, -free, free)


def proves_infeasible(qp, y, y_box) -> bool:
    """Return what the C library says of a ray (y, y_box) as a proof that no z keeps the limits."""
    problem = Problem(qp.n, qp.m)
    problem.P[:], problem.A[:] = qp.P, qp.A
    problem.low[:], problem.high[:] = np.append(qp.lb, qp.l), np.append(qp.ub, qp.u)
    library = load_own_c_library()
    library.active_set_factorise(problem.pointer, problem.P_pointer, problem.A_pointer)
    problem.lam[:] = np.append(y_box, y)
    return bool(library.active_set_is_proof(problem.pointer))
