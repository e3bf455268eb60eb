"""The libraries, one module each, with its routes: to write the module is to register it."""

from dpbench.solvers.adapter import adapters_in

NATIVE, THROUGH_QPSOLVERS = adapters_in(
    __name__, besides=("generic", "native_workspace", "qpsolvers_workspace")
)
"""By the name of the solver."""
