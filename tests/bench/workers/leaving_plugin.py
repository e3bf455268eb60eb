"""A solver that leaves, or never comes back, at its sixth call in a process."""

import os
import signal
import sys
import time

import numpy as np

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record


def stay():
    """As a library that holds the interpreter: no alarm reaches it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    time.sleep(600.0)


LEAVE = {
    "exit": lambda: os._exit(0),
    "system_exit": lambda: sys.exit(0),
    "abort": os.abort,
    "sleep": lambda: time.sleep(600.0),
    "stay": stay,
}["system_exit"]
CALLS = iter(range(1, 10**6))


def solve(qp):
    """Nothing but zeros, five times."""
    if next(CALLS) == 6:
        LEAVE()
    zero = np.zeros(qp.n)
    return Solution(Status.MAX_ITERATIONS, zero, np.zeros(qp.m), zero.copy())


RECORD = solver_record("leaving", method="none", module="quadprog", distribution="quadprog")
open = opener("leaving", solve)
