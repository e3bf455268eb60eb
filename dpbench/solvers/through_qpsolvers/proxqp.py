"""ProxQP (proxsuite) through qpsolvers: its status enumeration, time in microseconds."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus
from dpbench.solvers.contract import Options
from dpbench.solvers.record import NAN_IGNORED, Build, SolverRecord, vectorised_build


def build() -> Build:
    """Which of its modules ProxSuite chose for this processor."""
    return vectorised_build("proxsuite.proxsuite_pywrap")


RECORD = SolverRecord(
    name="proxqp",
    distribution="proxsuite",
    module="proxsuite",
    method="proximal augmented Lagrangian, semismooth Newton inside",
    extra="core",
    form="dense",
    box="native",
    policies={"qpsolvers": ("fresh", "warm")},
    start="primal",
    faults=NAN_IGNORED,
    build=build,
)

# "Closest feasible" means that the problem has no feasible point and a shifted one was solved.
STATUS = {
    "PROXQP_SOLVED": Status.SOLVED,
    "PROXQP_MAX_ITER_REACHED": Status.MAX_ITERATIONS,
    "PROXQP_PRIMAL_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PROXQP_DUAL_INFEASIBLE": Status.DUAL_INFEASIBLE,
}

DATA = {"H", "g", "A", "b", "C", "l", "u", "l_box", "u_box", "x", "y", "z", "verbose"}


def read_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status, outer plus inner iterations; it times itself only when `compute_timings` asks."""
    info = answer.extras["info"]
    name = info.status.name
    timed = bool(options.get("compute_timings", False))
    return ClaimedStatus(
        STATUS.get(name, Status.UNKNOWN),
        int(info.iter),
        round(info.run_time * 1e3) if timed else -1,
        name,
    )


def option_names() -> list[str]:
    """The keywords of `proxqp.dense.solve`, whose signature stands in its docstring only."""
    signature = str(import_module("proxsuite").proxqp.dense.solve.__doc__).split("->")[0]
    return [name for name in re.findall(r"[(,] ?(\w+): ", signature) if name not in DATA]


ADAPTER = Adapter(RECORD, read_status, option_names)
