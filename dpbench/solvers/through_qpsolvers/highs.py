"""HiGHS through qpsolvers, which passes on whether an answer was found and nothing else."""

from __future__ import annotations

from dpbench.solvers.adapter import QpsolversAdapter, attributes, found_is_all, made_by
from dpbench.solvers.record import NAN_IGNORED, RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="highs",
    family="active set",
    method="primal null-space active set",
    distribution="highspy",
    module="highspy",
    extra="solvers",
    form="csc",
    routes={"qpsolvers": RouteRecord(("fresh",), detects_infeasibility=False, faults=NAN_IGNORED)},
    levels=by_tolerance(
        "primal_feasibility_tolerance", "dual_feasibility_tolerance", qp_regularization_value=0.0
    ),
    project=stated(
        licence=("MIT", "HiGHS, metadata of its distribution"),
        language=("C++, C interface", "HiGHS documentation, front page"),
    ),
)


settings_object = made_by("highspy", "HighsOptions")
# Without a solution HiGHS fills x with zeros, which must not be taken for an iterate.
ADAPTER = QpsolversAdapter(
    RECORD,
    "native",
    found_is_all,
    lambda: attributes(settings_object()),
    settings_object,
    iterate_when_not_found=False,
)
