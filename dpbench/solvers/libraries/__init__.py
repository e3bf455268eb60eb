"""The libraries; to write a module with their adapters is to register them."""

from dpbench.solvers.adapter import adapters_in

NATIVE, THROUGH_QPSOLVERS = adapters_in(
    __name__, besides=("native_workspace", "qpsolvers_workspace")
)
"""By the name of the solver."""
