"""Solvers: the contract, the table, the tolerance levels and one adapter per library."""

from dpbench.solvers.contract import Policy, Route, Settings, Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.settings import describe_levels
from dpbench.solvers.table import (
    Availability,
    available,
    load_solver_module,
    record,
    solver_names,
)

__all__ = [
    "Availability",
    "Policy",
    "Route",
    "Settings",
    "Workspace",
    "available",
    "describe_levels",
    "load_solver_module",
    "open_workspace",
    "record",
    "solver_names",
]
