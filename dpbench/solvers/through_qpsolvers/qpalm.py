"""QPALM through qpsolvers: status texts of its C library, time in seconds."""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter, attributes, made_by
from dpbench.solvers.contract import Options
from dpbench.solvers.record import CSettings, RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="qpalm",
    family="augmented Lagrangian",
    method="proximal augmented Lagrangian with an exact line search",
    distribution="qpalm",
    module="qpalm",
    extra="solvers",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(
            ("fresh",),
            refused={
                "warm": "qpsolvers sets the start as a setting `x`, which QPALM does not have, and "
                "drops the error"
            },
        )
    },
    levels=by_tolerance("eps_abs", eps_rel=0.0, max_iter=100_000),
    project=stated(
        licence=("LGPL-3.0-or-later", "QPALM, metadata of its distribution"),
        language=("C", "QPALM README, Supported platforms"),
        c_settings=CSettings(
            "QPALMSettings", "qpalm_set_default_settings", "QPALM source, types.h"
        ),
    ),
)

STATUS = {
    "solved": Status.SOLVED,
    "dual terminated": Status.INACCURATE,
    "maximum iterations reached": Status.MAX_ITERATIONS,
    "primal infeasible": Status.PRIMAL_INFEASIBLE,
    "dual infeasible": Status.DUAL_INFEASIBLE,
    "time limit exceeded": Status.TIME_LIMIT,
    "user cancellation": Status.ERROR,
    "error": Status.ERROR,
}


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status, iterations and the run time with set-up."""
    info = answer.extras["info"]
    name = str(info.status)
    status = STATUS.get(name, Status.UNKNOWN)
    return ClaimedStatus(status, int(info.iter), round(info.run_time * 1e9), name)


settings_object = made_by("qpalm", "Settings")
ADAPTER = QpsolversAdapter(
    RECORD, "rows", read_status, lambda: attributes(settings_object()), settings_object
)
