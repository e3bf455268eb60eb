"""A solver that harms what is around it, by the number of variables it is given."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

FOREVER = ["sleep", "600"]


def ancestor(level):
    """The number of the process so many levels above this one."""
    pid = os.getpid()
    for _ in range(level):
        stat = Path(f"/proc/{pid}/stat").read_text()
        pid = int(stat.rpartition(")")[2].split()[1])
    return pid


def leave_daemons():
    """Processes whose parents ended, in sessions of their own."""
    for _ in range(5):
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                os.execvp(FOREVER[0], FOREVER)
            os._exit(0)
    # The last of them have begun by then.
    time.sleep(0.2)


def leave_and_exit():
    leave_daemons()
    os._exit(0)


def leave_and_kill():
    leave_daemons()
    kill(1)


def kill(level):
    os.kill(ancestor(level), signal.SIGKILL)
    time.sleep(600.0)


def stop(*levels):
    for pid in [ancestor(level) for level in levels]:
        os.kill(pid, signal.SIGSTOP)


def take_memory():
    """Some of it is written to, which takes its time; all of it counts."""
    taken = [np.ones(2**21) for _ in range(3)]
    while True:
        taken.append(np.empty(2**21))


def hang():
    """Never return from a call in C that holds the interpreter's lock and hears no signal."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    ctypes.PyDLL(None).pause()


def flood():
    for _ in range(20_000):
        print("x" * 1000)
    for _ in range(20):
        subprocess.run(
            ["head", "-c", "1000000", "/dev/zero"], stderr=subprocess.DEVNULL, check=False
        )
    sys.stdout.flush()


FAULTS = {
    2: lambda: signal.raise_signal(signal.SIGSEGV),
    3: os.abort,
    4: lambda: os._exit(0),
    5: hang,
    6: take_memory,
    7: flood,
    8: lambda: [subprocess.Popen(FOREVER) for _ in range(5)],
    9: leave_daemons,
    10: leave_and_exit,
    11: lambda: kill(1),
    12: lambda: kill(2),
    13: lambda: stop(1),
    14: lambda: stop(2, 1),
    17: lambda: stop(0),
    16: leave_and_kill,
}
DONE = set()


def solve(qp):
    """No optimum; at its first call with so many variables, the fault of that number."""
    if qp.n in FAULTS and qp.n not in DONE and "DPBENCH_TAME" not in os.environ:
        DONE.add(qp.n)
        FAULTS[qp.n]()
    zero = np.zeros(qp.n)
    return Solution(Status.MAX_ITERATIONS, zero, np.zeros(qp.m), zero.copy())


RECORD = solver_record("hostile", method="none", module="quadprog", distribution="quadprog")
open = opener("hostile", solve)
