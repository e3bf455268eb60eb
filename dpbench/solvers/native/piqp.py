"""PIQP through its own interface, dense, sparse or by stages: vectors updated, no start."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse

from dpbench.arrays import Vector
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.contract import Options, Policy
from dpbench.solvers.native.base import NativeWorkspace
from dpbench.solvers.record import NAN_IGNORED, RouteRecord, SolverRecord
from dpbench.solvers.through_qpsolvers import piqp as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse"),
    two_sided=True,
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
MULTISTAGE = replace(
    SPARSE,
    name="piqp_multistage",
    method="proximal interior point, factorised stage by stage",
)

STATUS = wrapped.STATUS


class PiqpWorkspace(NativeWorkspace):
    """PIQP with rows as h_l ≤ G x ≤ h_u, those with l = u as A x = b, and bounds as bounds.

    A row with l = u leaves an interior-point method no interior, so which rows are equalities is
    asked at every step; another pattern makes the library object anew.
    """

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record.name, record.form, policy, options)
        self._library = import_module("piqp")
        sparse = record.form == "csc"
        self._new = self._library.SparseSolver if sparse else self._library.DenseSolver

    def _convert(self) -> None:
        as_form = scipy.sparse.csc_matrix if self.form == "csc" else np.asfortranarray
        equal = self._l == self._u
        self._pattern = equal.tobytes()
        self._equal, self._unequal = np.flatnonzero(equal), np.flatnonzero(~equal)
        self._cost = as_form(self._P)
        self._equalities, self._rows = (
            as_form(self._A[rows]) if rows.size else None for rows in (self._equal, self._unequal)
        )

    def _library_object(self) -> Any:
        """An object of the library at its defaults."""
        return self._new()

    def _build(self) -> None:
        if (self._l == self._u).tobytes() != self._pattern:
            self._convert()
        solver = self._library_object()
        solver.settings.verbose = False
        for name, value in self._options.items():
            setattr(solver.settings, name, value)
        limits = self._limits(self._l, self._u)
        b, low, high = (limits.get(name) for name in ("b", "h_l", "h_u"))
        solver.setup(
            self._cost, self._q, self._equalities, b, self._rows, low, high, self._lb, self._ub
        )
        self._solver = solver

    def _limits(self, low: Vector, high: Vector) -> dict[str, Vector]:
        """The limits of the rows in the library's words."""
        if not self._equal.size:
            return {"h_l": low, "h_u": high} if self._m else {}
        limits = {"b": low[self._equal]}
        if self._unequal.size:
            limits |= {"h_l": low[self._unequal], "h_u": high[self._unequal]}
        return limits

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        if (low == high).tobytes() == self._pattern:
            self._solver.update(c=q, **self._limits(low, high))
            return
        self._q[:], self._l[:], self._u[:] = q, low, high
        self._build()

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
        if self._equal.size:
            inequalities, y = y, np.empty(self._m)
            y[self._equal], y[self._unequal] = found.y, inequalities
        detail = "" if status is Status.SOLVED else name
        return Solution(status, z, y, y_box, int(info.iter), reported_ns, detail)


class MultistageWorkspace(PiqpWorkspace):
    """PIQP with the factorisation that finds the stages of an optimal control problem."""

    def _library_object(self) -> Any:
        solver = super()._library_object()
        solver.settings.kkt_solver = self._library.sparse_multistage
        return solver


ADAPTER = NativeAdapter(
    wrapped.RECORD.with_native(NATIVE),
    PiqpWorkspace,
    wrapped.ADAPTER.option_names,
    wrapped.settings_object,
)
SPARSE_ADAPTER = NativeAdapter(
    SPARSE, PiqpWorkspace, wrapped.ADAPTER.option_names, wrapped.settings_object
)
MULTISTAGE_ADAPTER = NativeAdapter(
    MULTISTAGE, MultistageWorkspace, wrapped.ADAPTER.option_names, wrapped.settings_object
)
