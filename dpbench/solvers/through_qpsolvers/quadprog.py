"""quadprog through qpsolvers: it either solves, or raises that there is no solution."""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_FAULTS, RouteRecord, SolverRecord, stated

RECORD = SolverRecord(
    name="quadprog",
    family="active set",
    method="dual active set (Goldfarb-Idnani)",
    distribution="quadprog",
    module="quadprog",
    extra="core",
    form="dense",
    routes={"qpsolvers": RouteRecord(("fresh",), faults=NAN_FAULTS)},
    levels={},
    project=stated(
        licence=("GPL-2.0-or-later", "quadprog, metadata of its distribution"),
        language=("C, from Fortran", "quadprog, its source"),
    ),
    needs_strict_convexity=True,
)


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Only an answer that was found has extras; quadprog counts rows added and rows dropped."""
    return ClaimedStatus(Status.SOLVED, int(answer.extras["iterations"][0]))


# The library raises ValueError for arrays of the wrong kind, for a P that is not positive definite
# and for inconsistent constraints. The first cannot happen here and qpsolvers tells the second
# apart, so "not found" is the third. Its one keyword, `factorized`, says what P is: no setting.
ADAPTER = QpsolversAdapter(
    RECORD,
    "rows",
    read_status,
    lambda: (),
    not_found=ClaimedStatus(Status.PRIMAL_INFEASIBLE, detail="constraints are inconsistent"),
)
