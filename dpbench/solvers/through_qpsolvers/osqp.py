"""OSQP through qpsolvers: status values of its C library, time in seconds."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus, attributes
from dpbench.solvers.contract import Options
from dpbench.solvers.record import Build, SolverRecord


def build() -> Build:
    """The linear algebra it takes when none is asked for."""
    return Build(f"algebra {import_module('osqp').default_algebra()}")


RECORD = SolverRecord(
    name="osqp",
    distribution="osqp",
    module="osqp",
    method="operator splitting (ADMM)",
    extra="core",
    form="csc",
    box="rows",
    policies={"qpsolvers": ("fresh", "warm")},
    start="primal",
    build=build,
)

STATUS = {
    1: Status.SOLVED,
    2: Status.INACCURATE,
    3: Status.PRIMAL_INFEASIBLE,
    4: Status.PRIMAL_INFEASIBLE,
    5: Status.DUAL_INFEASIBLE,
    6: Status.DUAL_INFEASIBLE,
    7: Status.MAX_ITERATIONS,
    8: Status.TIME_LIMIT,
    9: Status.NUMERICAL_ERROR,
    10: Status.ERROR,
}


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status, iterations and the run time with set-up."""
    info = answer.extras["info"]
    status = STATUS.get(int(info.status_val), Status.UNKNOWN)
    return ClaimedStatus(status, int(info.iter), round(info.run_time * 1e9), str(info.status))


def settings_object() -> Any:
    """OSQP's settings at their defaults."""
    library = import_module("osqp.ext_builtin")
    settings = library.OSQPSettings()
    library.osqp_set_default_settings(settings)
    return settings


# Without raise_error, osqp 1.1 raises a warning at every solve.
ADAPTER = Adapter(
    RECORD,
    read_status,
    lambda: attributes(settings_object()),
    settings_object,
    fixed={"raise_error": False},
)
