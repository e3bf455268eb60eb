"""SIP through qpsolvers: its exit status; its settings come in groups."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter, attributes
from dpbench.solvers.contract import Options
from dpbench.solvers.record import RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="sip",
    family="interior point",
    method="barrier augmented Lagrangian interior point",
    distribution="sip-qp-python",
    module="sip_qp_python",
    extra="solvers",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(("fresh", "warm"), start="primal", detects_infeasibility=False)
    },
    levels=by_tolerance("eps_abs", eps_rel=0.0),
    project=stated(
        licence=("MIT", "SIP, metadata of its distribution"),
        language=("C++", "SIP QP README"),
        allocation_free=("yes, with Workspace::mem_assign", "SIP QP README"),
    ),
    # It orders its matrices with the AMD of CVXOPT.
    needs_modules=("cvxopt",),
    time_limit="time_limit",
)

STATUS = {
    "SOLVED": Status.SOLVED,
    "SUBOPTIMAL": Status.INACCURATE,
    "LOCALLY_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "ITERATION_LIMIT": Status.MAX_ITERATIONS,
    "LINE_SEARCH_ITERATION_LIMIT": Status.NUMERICAL_ERROR,
    "LINE_SEARCH_FAILURE": Status.NUMERICAL_ERROR,
    "TIMEOUT": Status.TIME_LIMIT,
    "FAILED_CHECK": Status.NUMERICAL_ERROR,
    "FACTORIZATION_FAILURE": Status.NUMERICAL_ERROR,
}

GROUPS = (
    "barrier",
    "line_search",
    "penalty",
    "regularization",
    "scaling",
    "termination",
)
# qpsolvers reads these three before it looks at SIP's own settings.
OF_QPSOLVERS = ("eps_abs", "eps_rel", "time_limit")


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status and iterations."""
    info = answer.extras["sip_output"]
    name = info.exit_status.name
    return ClaimedStatus(STATUS.get(name, Status.UNKNOWN), int(info.num_iterations), detail=name)


def option_names() -> list[str]:
    """Plain settings, and the members of each group as "group.name"."""
    settings = import_module("sip_qp_python").Settings()
    plain = [n for n in attributes(settings.sip) if n not in GROUPS and n != "logging"]
    grouped = [
        f"{group}.{name}"
        for group in GROUPS
        for name in attributes(
            getattr(settings if hasattr(settings, group) else settings.sip, group)
        )
    ]
    return [*OF_QPSOLVERS, *plain, *grouped]


THROUGH_QPSOLVERS = QpsolversAdapter(RECORD, "native", read_status, option_names)
