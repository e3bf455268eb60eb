"""PIQP through its own interface, dense or sparse: two-sided, vectors updated, no start."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import scipy.sparse

from dpbench.qp.program import Vector
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Policy
from dpbench.solvers.native.adapter import NativeAdapter
from dpbench.solvers.native.base import NativeWorkspace
from dpbench.solvers.record import NAN_IGNORED, RouteRecord, SolverRecord
from dpbench.solvers.through_qpsolvers import piqp as wrapped
from dpbench.solvers.through_qpsolvers.adapter import Options

NATIVE = RouteRecord(
    policies=("fresh", "reuse"),
    two_sided=True,
    detects_infeasibility=False,
    refused={"warm": "PIQP has no interface for a start"},
    faults=NAN_IGNORED,
)
SPARSE = replace(
    wrapped.RECORD,
    name="piqp_sparse",
    form="csc",
    policies={"native": NATIVE.policies},
    refused={("native", policy): why for policy, why in NATIVE.refused.items()},
    updates=NATIVE.updates,
    two_sided=NATIVE.two_sided,
    faults=NATIVE.faults,
)

STATUS = wrapped.STATUS


class PiqpWorkspace(NativeWorkspace):
    """PIQP with rows as h_l ≤ G x ≤ h_u and bounds as bounds."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record.name, record.form, policy, options)
        library = import_module("piqp")
        self._new = library.SparseSolver if record.form == "csc" else library.DenseSolver

    def _convert(self) -> None:
        as_form = scipy.sparse.csc_matrix if self.form == "csc" else np.asfortranarray
        self._cost, self._rows = as_form(self._P), as_form(self._A) if self._m else None

    def _build(self) -> None:
        solver = self._new()
        solver.settings.verbose = False
        for name, value in self._options.items():
            setattr(solver.settings, name, value)
        low, high = (self._l, self._u) if self._m else (None, None)
        solver.setup(self._cost, self._q, None, None, self._rows, low, high, self._lb, self._ub)
        self._solver = solver

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        if self._m:
            self._solver.update(c=q, h_l=low, h_u=high)
        else:
            self._solver.update(c=q)

    def _call(self) -> None:
        self._solver.solve()

    def _answer(self) -> Solution:
        found = self._solver.result
        info = found.info
        name = info.status.name
        status = STATUS.get(name, Status.UNKNOWN)
        timed = bool(self._options.get("compute_timings", False))
        reported_ns = round(info.solve_time * 1e9) if timed else -1
        if not status.usable:
            return self._missing(status, name, int(info.iter), reported_ns)
        # x is a view of the library's memory.
        z, y, y_box = found.x.copy(), found.z_u - found.z_l, found.z_bu - found.z_bl
        detail = "" if status is Status.SOLVED else name
        return Solution(status, z, y, y_box, int(info.iter), reported_ns, detail)


ADAPTER = NativeAdapter(
    wrapped.RECORD.with_native(NATIVE),
    PiqpWorkspace,
    wrapped.ADAPTER.option_names,
    wrapped.settings_object,
)
SPARSE_ADAPTER = NativeAdapter(
    SPARSE, PiqpWorkspace, wrapped.ADAPTER.option_names, wrapped.settings_object
)
