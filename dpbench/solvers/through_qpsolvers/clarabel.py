"""Clarabel through qpsolvers: status names as in its Rust source, time in seconds."""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter, attributes, made_by
from dpbench.solvers.contract import Options
from dpbench.solvers.record import RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="clarabel",
    family="interior point",
    method="primal-dual interior point, homogeneous embedding",
    distribution="clarabel",
    module="clarabel",
    extra="core",
    form="csc",
    routes={"qpsolvers": RouteRecord(("fresh",))},
    levels=by_tolerance("tol_gap_abs", "tol_gap_rel", "tol_feas", max_iter=500),
    project=stated(
        licence=("Apache-2.0", "Clarabel, metadata of its distribution"),
        language=("Rust", "Clarabel, metadata of its distribution"),
        single_precision=("yes, generic in its float type", "Clarabel.rs source, algebra/floats"),
    ),
)

# The "almost" infeasibility claims meet the reduced tolerances; they are claims all the same.
STATUS = {
    "Solved": Status.SOLVED,
    "AlmostSolved": Status.INACCURATE,
    "PrimalInfeasible": Status.PRIMAL_INFEASIBLE,
    "AlmostPrimalInfeasible": Status.PRIMAL_INFEASIBLE,
    "DualInfeasible": Status.DUAL_INFEASIBLE,
    "AlmostDualInfeasible": Status.DUAL_INFEASIBLE,
    "MaxIterations": Status.MAX_ITERATIONS,
    "MaxTime": Status.TIME_LIMIT,
    "NumericalError": Status.NUMERICAL_ERROR,
    "InsufficientProgress": Status.NUMERICAL_ERROR,
}


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Clarabel counts its set-up in the time it reports."""
    name = str(answer.extras["status"])
    status = STATUS.get(name, Status.UNKNOWN)
    return ClaimedStatus(status, reported_ns=round(answer.extras["solve_time"] * 1e9), detail=name)


settings_object = made_by("clarabel", "DefaultSettings")
ADAPTER = QpsolversAdapter(
    RECORD, "rows", read_status, lambda: attributes(settings_object()), settings_object
)
