"""OSQP through qpsolvers: status values of its C library, time in seconds."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter, attributes
from dpbench.solvers.contract import Options
from dpbench.solvers.record import (
    DEFAULT,
    HIGH,
    Build,
    CSettings,
    RouteRecord,
    SolverRecord,
    by_tolerance,
    stated,
)


def build() -> Build:
    """The linear algebra it takes when none is asked for."""
    return Build(f"algebra {import_module('osqp').default_algebra()}")


# OSQP 1.x adapts ρ every so many iterations by default, as others did by the clock: said aloud.
_LEVELS = by_tolerance(
    "eps_abs",
    eps_rel=0.0,
    max_iter=200_000,
    always={"adaptive_rho": 1, "adaptive_rho_interval": 50},
)
# Polishing is a second algorithm whose failures are silent, so it has names of its own.
_POLISHED = {f"{name}_polished": {**_LEVELS[name], "polishing": True} for name in (DEFAULT, HIGH)}

RECORD = SolverRecord(
    name="osqp",
    family="first order",
    method="operator splitting (ADMM)",
    distribution="osqp",
    module="osqp",
    extra="core",
    form="csc",
    routes={"qpsolvers": RouteRecord(("fresh", "warm"), start="primal")},
    levels={**_LEVELS, **_POLISHED},
    project=stated(
        licence=("Apache-2.0", "OSQP, metadata of its distribution"),
        language=("C, library-free", "OSQP web site, Features"),
        c_code=("yes, generates code for a problem", "OSQP web site, Features: Embeddable"),
        allocation_free=("yes, generated code", "OSQP web site, Features: no memory manager"),
        single_precision=("yes, OSQP_USE_FLOAT", "OSQP source, osqp_api_types.h"),
        c_settings=CSettings(
            "OSQPSettings", "osqp_set_default_settings", "OSQP source, osqp_api_types.h"
        ),
    ),
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
ADAPTER = QpsolversAdapter(
    RECORD,
    "rows",
    read_status,
    lambda: attributes(settings_object()),
    settings_object,
    fixed={"raise_error": False},
)
