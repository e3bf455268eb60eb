"""PIQP through qpsolvers: its status enumeration, time in seconds."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import QpsolversAdapter, attributes, read_enumerated
from dpbench.solvers.record import (
    NAN_IGNORED,
    RouteRecord,
    SolverRecord,
    by_tolerance,
    stated,
    vectorised_build,
)

RECORD = SolverRecord(
    name="piqp",
    family="interior point",
    method="proximal interior point",
    distribution="piqp",
    module="piqp",
    extra="core",
    form="dense",
    routes={"qpsolvers": RouteRecord(("fresh",), faults=NAN_IGNORED)},
    levels=by_tolerance(
        "eps_abs",
        "eps_duality_gap_abs",
        eps_rel=0.0,
        check_duality_gap=True,
        eps_duality_gap_rel=0.0,
        max_iter=1000,
    ),
    project=stated(
        licence=("BSD-2-Clause", "PIQP README, Features"),
        language=("C++14, C interface", "PIQP README, Features and Interfaces"),
        allocation_free=("yes, updates and re-solves", "PIQP README, Features"),
    ),
    build=lambda: vectorised_build("piqp.piqp_python"),
)

STATUS = {
    "PIQP_SOLVED": Status.SOLVED,
    "PIQP_MAX_ITER_REACHED": Status.MAX_ITERATIONS,
    "PIQP_PRIMAL_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PIQP_DUAL_INFEASIBLE": Status.DUAL_INFEASIBLE,
    "PIQP_NUMERICS": Status.NUMERICAL_ERROR,
    "PIQP_INVALID_SETTINGS": Status.ERROR,
}


def settings_object() -> Any:
    """PIQP's settings at their defaults."""
    return import_module("piqp").DenseSolver().settings


ADAPTER = QpsolversAdapter(
    RECORD,
    "native",
    read_enumerated(STATUS, 1e9),
    lambda: attributes(settings_object()),
    settings_object,
)
