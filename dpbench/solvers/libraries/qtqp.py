"""QTQP through qpsolvers: its status enumeration; it reports no time and no count by default."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import Options
from dpbench.solvers.record import RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="qtqp",
    family="interior point",
    method="primal-dual interior point, homogeneous embedding, in Python",
    distribution="qtqp",
    module="qtqp",
    extra="solvers",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(
            ("fresh",),
            refused={
                "warm": "qpsolvers does not hand a start on, and QTQP would need slacks and "
                "multipliers as well"
            },
        )
    },
    levels=by_tolerance("tol_feas", "tol_gap_abs", "tol_gap_rel", max_iter=500),
    project=stated(
        licence=("Apache-2.0", "QTQP, metadata of its distribution"),
        language=("Python", "QTQP README"),
    ),
)

STATUS = {
    "solved": Status.SOLVED,
    "almost_solved": Status.INACCURATE,
    "infeasible": Status.PRIMAL_INFEASIBLE,
    "unbounded": Status.DUAL_INFEASIBLE,
    "hit_max_iter": Status.MAX_ITERATIONS,
    "failed": Status.NUMERICAL_ERROR,
}


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status, and iterations where `collect_stats` asks for a row per iteration."""
    name = str(answer.extras["status"].value)
    rows = answer.extras["stats"]
    return ClaimedStatus(STATUS.get(name, Status.UNKNOWN), len(rows) if rows else -1, detail=name)


def option_names() -> list[str]:
    """List the keywords of `QTQP.solve` that are no start."""
    names = inspect.signature(import_module("qtqp").QTQP.solve).parameters
    return [name for name in names if name not in ("self", "verbose", "warm_start")]


THROUGH_QPSOLVERS = QpsolversAdapter(RECORD, "rows", read_status, option_names)
