"""Importing this module loads or compiles the kernels of dpbench's own solvers.

A template that cells are forked from imports it where a cell runs one of them, so that no step of a
run has to.
"""

import numpy as np

from dpbench.qp.program import QuadraticProgram
from dpbench.solvers.own import hildreth
from dpbench.solvers.own.paper_active_set import PaperActiveSetWorkspace

__all__ = ["hildreth"]


def _load_kernels() -> None:
    """Solve a QP of one variable so that the compiled functions of the solvers are loaded."""
    one = np.ones(1)
    workspace = PaperActiveSetWorkspace("paper_active_set", "native", "reuse")
    workspace.setup(QuadraticProgram(np.eye(1), one, np.eye(1), -one, one, -one, one))
    workspace.solve()


_load_kernels()
