"""Keeping other solver libraries out of a process that measures one of them.

`import qpsolvers` imports every solver library it finds, which costs time and memory, starts
threads and lets one library's OpenMP or BLAS settings act on another's.
"""

from __future__ import annotations

import sys

from dpbench.errors import DpbenchError
from dpbench.solvers.table import TABLE, record

# Libraries that qpsolvers looks for and that are not in the table.
OTHERS = (
    "coptpy",
    "gurobipy",
    "hpipm_python",
    "jax",
    "mosek",
    "nppro",
    "pdhcg",
    "qpoases",
    "qpSWIFT",
)


def isolate(*solvers: str) -> None:
    """Hide every solver library but those of `solvers` from this process, for good.

    Raises
    ------
    UnknownNameError : there is no such solver.
    DpbenchError : qpsolvers was imported before, so it is too late.
    """
    rows = [record(solver) for solver in solvers]
    if "qpsolvers" in sys.modules:
        raise DpbenchError("isolate comes too late: qpsolvers has been imported in this process")
    keep = {module for row in rows for module in (row.module, *row.needs_modules)}
    modules = {entry.module for entry in TABLE.values() if entry.module}
    # What a solver outside the table needs is not known.
    others = () if any(row.extra == "qpsolvers" for row in rows) else OTHERS
    for module in (*modules, *others):
        if module not in keep:
            sys.modules[module] = None  # type: ignore[assignment]  # None is how Python hides one
