"""Clarabel through qpsolvers: status names as in its Rust source, time in seconds."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus, attributes
from dpbench.solvers.contract import Options
from dpbench.solvers.record import SolverRecord

RECORD = SolverRecord(
    name="clarabel",
    distribution="clarabel",
    module="clarabel",
    method="primal-dual interior point, homogeneous embedding",
    extra="core",
    form="csc",
    box="rows",
    policies={"qpsolvers": ("fresh",)},
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


def settings_object() -> Any:
    """Clarabel's settings at their defaults."""
    return import_module("clarabel").DefaultSettings()


ADAPTER = Adapter(RECORD, read_status, lambda: attributes(settings_object()), settings_object)
