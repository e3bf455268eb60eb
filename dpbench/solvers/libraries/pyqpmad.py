"""qpmad (pyqpmad) through qpsolvers, which drops the status of an answer that was not found."""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter, made_by
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_FAULTS, RouteRecord, SolverRecord, stated

RECORD = SolverRecord(
    name="pyqpmad",
    family="active set",
    method="dual active set (Goldfarb-Idnani)",
    distribution="pyqpmad",
    module="pyqpmad",
    extra="solvers",
    form="dense",
    routes={"qpsolvers": RouteRecord(("fresh",), detects_infeasibility=False, faults=NAN_FAULTS)},
    levels={},
    project=stated(
        licence=("BSD-3-Clause", "pyqpmad, LICENSE of its distribution"),
        language=("C++, header-only on Eigen", "qpmad README"),
        allocation_free=("yes, after reserve", "pyqpmad README, Control Loop Example"),
    ),
    needs_strict_convexity=True,
)


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Only an answer that was found has extras, and they hold the iterations alone."""
    return ClaimedStatus(Status.SOLVED, int(answer.extras["num_iterations"]))


settings_object = made_by("pyqpmad", "SolverParameters")
THROUGH_QPSOLVERS = QpsolversAdapter(RECORD, "rows", read_status, settings_object=settings_object)
