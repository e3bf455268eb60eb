"""A native solver as a newcomer adds it: this file in `libraries/`, and nothing else.

It is quadprog under another name, which keeps nothing from step to step.
"""

from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.contract import (
    NAN_FAULTS,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.quadprog import QuadprogWorkspace

RECORD = SolverRecord(
    name="newcomer",
    family="augmented Lagrangian",
    method="that of the example",
    distribution="quadprog",
    module="quadprog",
    extra="core",
    form="dense",
    routes={
        "native": RouteRecord(
            ("fresh",),
            refused={"reuse": "the example keeps nothing", "warm": "the example has no start"},
            faults=NAN_FAULTS,
        )
    },
    levels=make_tolerance_presets("precision", always={"care": 1}),
    project=make_project_facts(
        licence=("MIT", "the example"),
        language=("C", "the example"),
        c_code=("yes, all of it", "the example"),
        allocation_free=None,
        single_precision=None,
    ),
    needs_strict_convexity=True,
)
ADAPTER = NativeAdapter(RECORD, QuadprogWorkspace, lambda: ("care", "precision"))
