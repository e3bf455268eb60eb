"""A solver that qpsolvers serves and dpbench has no record of: it runs with what is sure of all.

Its matrices stay dense and its bounds bounds, as qpsolvers takes them; whether an answer was found
is all that is known of it.
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from importlib.util import find_spec

from dpbench.solvers.adapter import QpsolversAdapter, found_is_all
from dpbench.solvers.contract import Policy
from dpbench.solvers.record import NOT_STATED, RouteRecord, SolverRecord


def is_served(name: str) -> bool:
    """Whether qpsolvers has a solver of that name, installed or not, without importing it."""
    loaded = sys.modules.get("qpsolvers")
    if loaded is not None and name in loaded.available_solvers:
        return True
    spec = find_spec("qpsolvers") if loaded is None else loaded.__spec__
    places = [f"{place}/solvers" for place in (spec and spec.submodule_search_locations) or ()]
    return name.isidentifier() and PathFinder.find_spec(f"{name}_", places) is not None


def generic_adapter(name: str) -> QpsolversAdapter:
    """Make the adapter of a solver known by name only; it checks no settings."""
    unknown: dict[Policy, str] = {"warm": "whether it takes a start is not known"}
    record = SolverRecord(
        name=name,
        family="not stated",
        method="not in the table; as qpsolvers drives it",
        distribution=name,
        module="qpsolvers",
        extra="qpsolvers",
        form="dense",
        routes={"qpsolvers": RouteRecord(("fresh",), detects_infeasibility=False, refused=unknown)},
        levels={},
        project=NOT_STATED,
    )
    return QpsolversAdapter(record, "native", found_is_all, None)
