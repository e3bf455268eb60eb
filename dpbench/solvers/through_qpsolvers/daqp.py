"""DAQP through qpsolvers, which passes on whether an answer was found and nothing else."""

from __future__ import annotations

import inspect
from importlib import import_module

from dpbench.solvers.adapter import Adapter, status_of_found
from dpbench.solvers.record import NAN_ANSWER, NAN_IGNORED, SolverRecord

RECORD = SolverRecord(
    name="daqp",
    distribution="daqp",
    module="daqp",
    method="dual active set, LDLᵀ updates of the Gram matrix of the active rows",
    extra="core",
    form="dense",
    box="native",
    policies={"qpsolvers": ("fresh", "warm")},
    start="primal",
    detects_infeasibility=False,
    faults={**NAN_ANSWER, **NAN_IGNORED},
)

DATA = {"H", "f", "A", "bupper", "blower", "sense", "break_points", "is_avi"}
STARTS = {"primal_start", "dual_start"}


def option_names() -> list[str]:
    """The keywords of `daqp.solve` that are neither data nor a start."""
    names = inspect.signature(import_module("daqp").solve).parameters
    return [name for name in names if name not in DATA | STARTS]


ADAPTER = Adapter(RECORD, status_of_found, option_names)
