"""DAQP under the name `slowed_daqp`, each step made longer by a share of itself.

The share is that of the environment variable DPBENCH_SLOWED_BY, 0 without it. A regression that
is honest: the solver does its work and then keeps the processor busy before the clock is read.
"""

import os
from time import perf_counter_ns

from dpbench.solvers.libraries.daqp import NATIVE, DaqpWorkspace
from dpbench.solvers.plugins import solver_record

SHARE = float(os.environ.get("DPBENCH_SLOWED_BY", "0"))
RECORD = solver_record(
    "slowed_daqp", method="active set", policies=("fresh", "reuse", "warm"), module="daqp"
)


class SlowedWorkspace(DaqpWorkspace):
    """DAQP that takes longer by `SHARE` of the time from its set-up or update to its answer."""

    def setup(self, qp):
        self._began = perf_counter_ns()
        super().setup(qp)

    def update(self, step):
        self._began = perf_counter_ns()
        super().update(step)

    def read(self):
        answer = super().read()
        now = perf_counter_ns()
        until = now + SHARE * (now - self._began)
        while perf_counter_ns() < until:
            pass
        return answer


def open(policy, options):
    """A workspace of DAQP's own record, whose capabilities are the same."""
    return SlowedWorkspace(NATIVE.record, policy, options)
