"""quadprog through qpsolvers: it either solves, or raises that there is no solution."""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_ANSWER, NAN_IGNORED, SolverRecord

RECORD = SolverRecord(
    name="quadprog",
    distribution="quadprog",
    module="quadprog",
    method="dual active set (Goldfarb-Idnani)",
    extra="core",
    form="dense",
    box="rows",
    policies={"qpsolvers": ("fresh",)},
    needs_strict_convexity=True,
    faults={**NAN_ANSWER, **NAN_IGNORED},
)


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Only an answer that was found has extras; quadprog counts rows added and rows dropped."""
    return ClaimedStatus(Status.SOLVED, int(answer.extras["iterations"][0]))


# The library raises ValueError for arrays of the wrong kind, for a P that is not positive definite
# and for inconsistent constraints. The first cannot happen here and qpsolvers tells the second
# apart, so "not found" is the third. Its one keyword, `factorized`, says what P is: no setting.
ADAPTER = Adapter(
    RECORD,
    read_status,
    lambda: (),
    not_found=ClaimedStatus(Status.PRIMAL_INFEASIBLE, detail="constraints are inconsistent"),
)
