"""ECOS through qpsolvers, as a second-order cone program: exit flags, time in seconds."""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import Options
from dpbench.solvers.record import RouteRecord, SolverRecord, by_tolerance, stated

# Dense, because qpsolvers builds the cone program from dense P and G.
RECORD = SolverRecord(
    name="ecos",
    family="interior point",
    method="primal-dual interior point on the equivalent second-order cone program",
    distribution="ecos",
    module="ecos",
    extra="solvers",
    form="dense",
    routes={"qpsolvers": RouteRecord(("fresh",))},
    levels=by_tolerance("abstol", "reltol", "feastol", max_iters=500),
    project=stated(
        licence=("GPL-3.0", "ECOS, metadata of its distribution"),
        language=("C", "ECOS README"),
    ),
    needs_strict_convexity=True,
)

STATUS = {
    0: Status.SOLVED,
    1: Status.PRIMAL_INFEASIBLE,
    2: Status.DUAL_INFEASIBLE,
    10: Status.INACCURATE,
    11: Status.PRIMAL_INFEASIBLE,
    12: Status.DUAL_INFEASIBLE,
    -1: Status.MAX_ITERATIONS,
    -2: Status.NUMERICAL_ERROR,
    -3: Status.NUMERICAL_ERROR,
    -4: Status.ERROR,
    -7: Status.ERROR,
}

# The README of ecos-python; its C function has no signature to ask and refuses other names.
OPTION_NAMES = (
    "abstol",
    "abstol_inacc",
    "feastol",
    "feastol_inacc",
    "max_iters",
    "nitref",
    "reltol",
    "reltol_inacc",
)


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Exit flag, iterations and the run time with set-up."""
    info = answer.extras
    return ClaimedStatus(
        STATUS.get(int(info["exitFlag"]), Status.UNKNOWN),
        int(info["iter"]),
        round(info["timing"]["runtime"] * 1e9),
        str(info["infostring"]),
    )


THROUGH_QPSOLVERS = QpsolversAdapter(RECORD, "rows", read_status, lambda: OPTION_NAMES)
