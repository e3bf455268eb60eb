"""CVXOPT and its fork KVXOPT through qpsolvers: one algorithm, `coneqp`, in two libraries.

`coneqp` knows two statuses, "optimal" and "unknown"; the latter means its iteration limit or a
breakdown of the factorisation, told apart by the iteration count.
"""

from __future__ import annotations

from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_ANSWER, NAN_IGNORED, SolverRecord

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


def _record(name: str) -> SolverRecord:
    return SolverRecord(
        name=name,
        distribution=name,
        module=name,
        method="primal-dual interior point with Nesterov-Todd scaling (coneqp)",
        extra="solvers",
        form="dense",
        box="rows",
        policies={"qpsolvers": ("fresh", "warm")},
        start="primal",
        detects_infeasibility=False,
        faults={**NAN_ANSWER, **NAN_IGNORED},
    )


CVXOPT = Adapter(_record("cvxopt"), read_status, lambda: OPTION_NAMES)
KVXOPT = Adapter(_record("kvxopt"), read_status, lambda: OPTION_NAMES)
