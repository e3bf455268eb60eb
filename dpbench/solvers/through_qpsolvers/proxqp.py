"""ProxQP (proxsuite) through qpsolvers: its status enumeration, time in microseconds.

Its iterations are outer plus inner ones.
"""

from __future__ import annotations

import re
from importlib import import_module

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import QpsolversAdapter, read_enumerated
from dpbench.solvers.record import (
    NAN_IGNORED,
    RouteRecord,
    SolverRecord,
    by_tolerance,
    stated,
    vectorised_build,
)

RECORD = SolverRecord(
    name="proxqp",
    family="augmented Lagrangian",
    method="proximal augmented Lagrangian, semismooth Newton inside",
    distribution="proxsuite",
    module="proxsuite",
    extra="core",
    form="dense",
    routes={"qpsolvers": RouteRecord(("fresh", "warm"), start="primal", faults=NAN_IGNORED)},
    levels=by_tolerance(
        "eps_abs",
        "eps_duality_gap_abs",
        eps_rel=0.0,
        check_duality_gap=True,
        eps_duality_gap_rel=0.0,
    ),
    project=stated(
        licence=("BSD-2-Clause", "ProxSuite documentation, What is ProxSuite?"),
        language=("C++14", "ProxSuite README, main features"),
    ),
    build=lambda: vectorised_build("proxsuite.proxsuite_pywrap"),
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


def option_names() -> list[str]:
    """The keywords of `proxqp.dense.solve`, whose signature stands in its docstring only."""
    signature = str(import_module("proxsuite").proxqp.dense.solve.__doc__).split("->")[0]
    return [name for name in re.findall(r"[(,] ?(\w+): ", signature) if name not in DATA]


ADAPTER = QpsolversAdapter(RECORD, "native", read_enumerated(STATUS, 1e3), option_names)
