"""Solvers: the contract, the table, the ladder of settings and one adapter per library."""

from dpbench.solvers.contract import Policy, Route, Settings, Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import Availability, available, record, solver_names

__all__ = [
    "Availability",
    "Policy",
    "Route",
    "Settings",
    "Workspace",
    "available",
    "open_workspace",
    "record",
    "solver_names",
]
