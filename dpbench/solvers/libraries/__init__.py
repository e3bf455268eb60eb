"""The libraries through their own interfaces, one module each: to write it is to register it."""

from dpbench.solvers.adapter import NativeAdapter, adapters_in

NATIVE = adapters_in(__name__, NativeAdapter, besides=("native_workspace",))
"""By the name of the solver."""
