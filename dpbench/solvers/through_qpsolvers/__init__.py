"""The libraries behind qpsolvers, one module a library: to write its module is to register it."""

from dpbench.solvers.adapter import QpsolversAdapter, adapters_in

ADAPTERS = adapters_in(__name__, QpsolversAdapter, besides=("generic", "workspace"))
"""By the name of the solver."""
