"""ADMM in NumPy: `dpbench run paper --solver admm --solver-module example_plugin.py`."""

import numpy as np

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record


def solve(qp, tolerance=1e-4):
    """Minimise ½ zᵀP z + qᵀz subject to low ≤ C z ≤ high, with C = [A; I]."""
    C = np.vstack([qp.A, np.eye(qp.n)])
    low, high = np.append(qp.l, qp.lb), np.append(qp.u, qp.ub)
    K = np.linalg.inv(qp.P + C.T @ C)
    w = y = np.zeros(len(C))
    for k in range(10_000):
        z = K @ (C.T @ (w - y) - qp.q)
        before, w = w, np.clip(C @ z + y, low, high)
        y = y + C @ z - w
        if max(abs(C @ z - w).max(), abs(w - before).max()) < tolerance:
            return Solution(Status.SOLVED, z, y[: qp.m], y[qp.m :], k)
    return Solution(Status.MAX_ITERATIONS, z, y[: qp.m], y[qp.m :], k)


RECORD = solver_record("admm", method="ADMM", family="first order", detects_infeasibility=False)
LEVELS = {"low": {"tolerance": 1e-3}, "mid": {"tolerance": 1e-6}, "high": {"tolerance": 1e-9}}
open = opener("admm", solve)
