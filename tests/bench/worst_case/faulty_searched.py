"""A solver that counts nothing, and crashes or hangs where the surge force goes astern at full
rate."""

import os
import time

import numpy as np
import quadprog

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

MODE = "none"


def solve(qp):
    C = np.vstack((qp.A, -qp.A, np.eye(qp.n), -np.eye(qp.n)))
    low = np.concatenate((qp.l, -qp.u, qp.lb, -qp.ub))
    z = quadprog.solve_qp(qp.P, -qp.q, C.T.copy(), low)[0]
    backs_off = z[0] < -0.99
    if MODE == "crash" and backs_off:
        os.abort()
    if MODE == "hang" and backs_off:
        time.sleep(60.0)
    return Solution(Status.SOLVED, z, np.full(qp.m, np.nan), np.full(qp.n, np.nan))


RECORD = solver_record("searched", method="none", module="quadprog", distribution="quadprog")
open = opener("searched", solve)
