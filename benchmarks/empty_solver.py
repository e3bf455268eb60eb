"""A solver that does nothing, under twelve configurations: what remains of a cell is the campaign.

Its answer is none, so that the fallback steers the ship; it is set up from nothing, or not at all.
"""

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Workspace
from dpbench.solvers.plugins import solver_record

RECORD = solver_record(
    "empty", method="none", policies=("fresh", "reuse", "warm"), detects_infeasibility=False
)
LEVELS = {level: {"unused": i} for i, level in enumerate(("low", "mid", "high"))}


class EmptyWorkspace(Workspace):
    """Every method returns at once, `read` always the same stored object."""

    def __init__(self, policy):
        super().__init__("empty", "native", policy)
        self.setup_every_step = policy == "fresh"
        self._answer = None

    def setup(self, qp):
        self._answer = self._answer or Solution.without_point(qp.n, qp.m, Status.UNKNOWN)

    def update(self, step):
        pass

    def solve(self):
        pass

    def read(self):
        return self._answer


def open(policy, options):
    """Whatever the options."""
    return EmptyWorkspace(policy)
