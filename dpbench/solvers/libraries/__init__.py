"""The libraries; to write a module with their adapters is to register them."""

from dpbench.solvers.adapter import import_all_adapters

NATIVE, THROUGH_QPSOLVERS = import_all_adapters(
    __name__, besides=("hpipm_library", "native_workspace", "qpsolvers_workspace")
)
"""Adapters by the name of the solver."""
