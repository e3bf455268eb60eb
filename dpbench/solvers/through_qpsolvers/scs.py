"""SCS through qpsolvers: status values of its C library, time in milliseconds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import Options
from dpbench.solvers.record import CSettings, RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="scs",
    family="first order",
    method="operator splitting on the homogeneous embedding, Anderson acceleration",
    distribution="scs",
    module="scs",
    extra="solvers",
    form="csc",
    routes={"qpsolvers": RouteRecord(("fresh", "warm"), start="primal")},
    levels=by_tolerance("eps_abs", eps_rel=0.0, max_iters=1_000_000),
    project=stated(
        licence=("MIT", "SCS, metadata of its distribution"),
        language=("C", "SCS documentation, front page"),
        single_precision=("yes, a flag of its build", "SCS source, scs.mk"),
        c_settings=CSettings("ScsSettings", "scs_set_default_settings", "SCS source, scs.h"),
    ),
)

STATUS = {
    1: Status.SOLVED,
    2: Status.INACCURATE,
    -1: Status.DUAL_INFEASIBLE,
    -2: Status.PRIMAL_INFEASIBLE,
    -4: Status.NUMERICAL_ERROR,
    -5: Status.ERROR,
    -6: Status.DUAL_INFEASIBLE,
    -7: Status.PRIMAL_INFEASIBLE,
}

# The page "Settings" of its manual; its C type has no signature to ask and refuses other names.
OPTION_NAMES = (
    "acceleration_interval",
    "acceleration_lookback",
    "adaptive_scale",
    "alpha",
    "eps_abs",
    "eps_infeas",
    "eps_rel",
    "max_iters",
    "normalize",
    "rho_x",
    "scale",
    "time_limit_secs",
)


def status_of(info: Mapping[str, Any]) -> Status:
    """The status in SCS's information about a solve."""
    status = STATUS.get(int(info["status_val"]), Status.UNKNOWN)
    # An inaccurate answer names the limit that stopped it in its text.
    if status is Status.INACCURATE and "time_limit" in info["status"]:
        status = Status.TIME_LIMIT
    elif status is Status.INACCURATE and "max_iters" in info["status"]:
        status = Status.MAX_ITERATIONS
    return status


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status, iterations and the sum of set-up and solve time."""
    info = answer.extras
    status = status_of(info)
    milliseconds = info["setup_time"] + info["solve_time"]
    return ClaimedStatus(status, int(info["iter"]), round(milliseconds * 1e6), str(info["status"]))


ADAPTER = QpsolversAdapter(RECORD, "rows", read_status, lambda: OPTION_NAMES)
