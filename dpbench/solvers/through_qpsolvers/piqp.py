"""PIQP through qpsolvers: its status enumeration, time in seconds."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus, attributes
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_IGNORED, Build, SolverRecord, vectorised_build


def build() -> Build:
    """Which of its modules PIQP chose for this processor."""
    return vectorised_build("piqp.piqp_python")


RECORD = SolverRecord(
    name="piqp",
    distribution="piqp",
    module="piqp",
    method="proximal interior point",
    extra="core",
    form="dense",
    box="native",
    policies={"qpsolvers": ("fresh",)},
    faults=NAN_IGNORED,
    build=build,
)

STATUS = {
    "PIQP_SOLVED": Status.SOLVED,
    "PIQP_MAX_ITER_REACHED": Status.MAX_ITERATIONS,
    "PIQP_PRIMAL_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PIQP_DUAL_INFEASIBLE": Status.DUAL_INFEASIBLE,
    "PIQP_NUMERICS": Status.NUMERICAL_ERROR,
    "PIQP_INVALID_SETTINGS": Status.ERROR,
}


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status and iterations; PIQP times itself only when `compute_timings` asks for it."""
    info = answer.extras["info"]
    name = info.status.name
    timed = bool(options.get("compute_timings", False))
    return ClaimedStatus(
        STATUS.get(name, Status.UNKNOWN),
        int(info.iter),
        round(info.run_time * 1e9) if timed else -1,
        name,
    )


def settings_object() -> Any:
    """PIQP's settings at their defaults."""
    return import_module("piqp").DenseSolver().settings


ADAPTER = Adapter(RECORD, read_status, lambda: attributes(settings_object()), settings_object)
