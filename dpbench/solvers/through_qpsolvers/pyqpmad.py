"""qpmad (pyqpmad) through qpsolvers, which drops the status of an answer that was not found."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus, attributes
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_ANSWER, NAN_IGNORED, SolverRecord

RECORD = SolverRecord(
    name="pyqpmad",
    distribution="pyqpmad",
    module="pyqpmad",
    method="dual active set (Goldfarb-Idnani)",
    extra="solvers",
    form="dense",
    box="rows",
    policies={"qpsolvers": ("fresh",)},
    needs_strict_convexity=True,
    detects_infeasibility=False,
    faults={**NAN_ANSWER, **NAN_IGNORED},
)


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Only an answer that was found has extras, and they hold the iterations alone."""
    return ClaimedStatus(Status.SOLVED, int(answer.extras["num_iterations"]))


def settings_object() -> Any:
    """qpmad's parameters at their defaults."""
    return import_module("pyqpmad").SolverParameters()


ADAPTER = Adapter(RECORD, read_status, lambda: attributes(settings_object()), settings_object)
