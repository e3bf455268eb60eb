"""CVXOPT and its fork KVXOPT through qpsolvers: one algorithm, `coneqp`, in two libraries.

`coneqp` knows two statuses, "optimal" and "unknown"; the latter means its iteration limit or a
breakdown of the factorisation, told apart by the iteration count.
"""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_FAULTS, RouteRecord, SolverRecord, by_tolerance, stated

# The user guide of CVXOPT, section "Algorithm parameters", and the source of `coneqp`; the
# library keeps no object to ask and ignores what it does not know.
OPTION_NAMES = (
    "abstol",
    "feastol",
    "kktreg",
    "maxiters",
    "refinement",
    "reltol",
    "use_correction",
)
DEFAULT_MAXITERS = 100


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status and iterations; `coneqp` reports no time."""
    name, iterations = str(answer.extras["status"]), int(answer.extras["iterations"])
    if name == "optimal":
        status = Status.SOLVED
    elif iterations >= int(str(options.get("maxiters", DEFAULT_MAXITERS))):
        status = Status.MAX_ITERATIONS
    else:
        status = Status.NUMERICAL_ERROR
    return ClaimedStatus(status, iterations, detail=name)


def _record(name: str, licensed: str) -> SolverRecord:
    return SolverRecord(
        name=name,
        family="interior point",
        method="primal-dual interior point with Nesterov-Todd scaling (coneqp)",
        distribution=name,
        module=name,
        extra="solvers",
        form="dense",
        routes={
            "qpsolvers": RouteRecord(
                ("fresh", "warm"),
                start="primal",
                detects_infeasibility=False,
                faults=NAN_FAULTS,
            )
        },
        levels=by_tolerance("abstol", "reltol", "feastol", maxiters=200),
        project=stated(
            licence=("GPL-3.0-or-later", licensed),
            language=("Python and C", f"{name.upper()}, metadata of its distribution"),
        ),
    )


CVXOPT = QpsolversAdapter(
    _record("cvxopt", "CVXOPT, Copyright and license"), "rows", read_status, lambda: OPTION_NAMES
)
KVXOPT = QpsolversAdapter(
    _record("kvxopt", "KVXOPT, metadata of its distribution"),
    "rows",
    read_status,
    lambda: OPTION_NAMES,
)
