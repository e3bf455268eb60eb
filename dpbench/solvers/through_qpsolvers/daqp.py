"""DAQP through qpsolvers, which passes on whether an answer was found and nothing else."""

from __future__ import annotations

import inspect
from importlib import import_module

from dpbench.solvers.adapter import QpsolversAdapter, found_is_all
from dpbench.solvers.record import (
    NAN_FAULTS,
    CSettings,
    RouteRecord,
    SolverRecord,
    by_tolerance,
    stated,
)

RECORD = SolverRecord(
    name="daqp",
    family="active set",
    method="dual active set, LDLᵀ updates of the Gram matrix of the active rows",
    distribution="daqp",
    module="daqp",
    extra="core",
    form="dense",
    routes={
        "qpsolvers": RouteRecord(
            ("fresh", "warm"),
            start="primal",
            detects_infeasibility=False,
            faults=NAN_FAULTS,
        )
    },
    # dual_tol stays at DAQP's own 1e-12, which is tighter.
    # A semidefinite P it solves by proximal steps, which end by a tolerance of their own.
    levels=by_tolerance("primal_tol", "eta_prox"),
    project=stated(
        licence=("MIT", "DAQP, metadata of its distribution"),
        language=("C, library-free", "DAQP README"),
        c_code=("yes, renders a workspace", "DAQP source, codegen"),
        allocation_free=("yes, after setup", "DAQP Python interface, docstring of Model"),
        single_precision=("yes, DAQP_SINGLE_PRECISION", "DAQP source, include/types.h"),
        c_settings=CSettings(
            "DAQPSettings", "daqp_default_settings", "DAQP source, include/types.h and api.h"
        ),
    ),
)

DATA = {"H", "f", "A", "bupper", "blower", "sense", "break_points", "is_avi"}
STARTS = {"primal_start", "dual_start"}


def option_names() -> list[str]:
    """The keywords of `daqp.solve` that are neither data nor a start."""
    names = inspect.signature(import_module("daqp").solve).parameters
    return [name for name in names if name not in DATA | STARTS]


ADAPTER = QpsolversAdapter(RECORD, "native", found_is_all, option_names)
