"""HiGHS through qpsolvers, which passes on whether an answer was found and nothing else."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpbench.solvers.adapter import Adapter, attributes, status_of_found
from dpbench.solvers.record import NAN_IGNORED, SolverRecord

RECORD = SolverRecord(
    name="highs",
    distribution="highspy",
    module="highspy",
    method="primal null-space active set",
    extra="solvers",
    form="csc",
    box="native",
    policies={"qpsolvers": ("fresh",)},
    detects_infeasibility=False,
    faults=NAN_IGNORED,
)


def settings_object() -> Any:
    """HiGHS's options at their defaults."""
    return import_module("highspy").HighsOptions()


# Without a solution HiGHS fills x with zeros, which must not be taken for an iterate.
ADAPTER = Adapter(
    RECORD,
    status_of_found,
    lambda: attributes(settings_object()),
    settings_object,
    iterate_when_not_found=False,
)
