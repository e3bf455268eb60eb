"""A solver that lies, dies or hangs, by the number of variables it is given."""

import os
import time

import numpy as np
import quadprog

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

FAR, EMPTY, DEATH, SLEEP = 4, 5, 6, 7


def solve(qp):
    """A wrong plan, a false "infeasible", a crash or no return; the optimum otherwise."""
    zero, none = np.zeros(qp.m), np.full(qp.n, np.nan)
    if qp.n == FAR:
        return Solution(Status.SOLVED, np.full(qp.n, 9.0), zero, np.zeros(qp.n))
    if qp.n == EMPTY:
        return Solution(Status.PRIMAL_INFEASIBLE, none, np.full(qp.m, np.nan), none)
    if qp.n == DEATH:
        os.abort()
    if qp.n == SLEEP:
        time.sleep(60.0)
    C = np.vstack((np.eye(qp.n), -np.eye(qp.n)))
    answer = quadprog.solve_qp(qp.P, -qp.q, C.T.copy(), np.concatenate((qp.lb, -qp.ub)))
    return Solution(Status.SOLVED, answer[0], zero, answer[4][qp.n :] - answer[4][: qp.n])


RECORD = solver_record("faulty", method="none", module="quadprog", distribution="quadprog")
open = opener("faulty", solve)
