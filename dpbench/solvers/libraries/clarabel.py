"""Clarabel through its own interface: one-sided, vectors updated, no start."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace
from dpbench.solvers.record import RouteRecord
from dpbench.solvers.through_qpsolvers import clarabel as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse"),
    updates="vectors",
    keeps="the equilibration it took from P, A and q at its set-up",
    refused={"warm": "Clarabel has no interface for a start"},
)

STATUS = wrapped.STATUS


class ClarabelWorkspace(OneSidedWorkspace):
    """Clarabel on [A; G] z + s = [b; h] with a zero cone and a nonnegative cone."""

    _result: Any

    def _arrange(self) -> None:
        rows, equalities, inequalities = self._rows()
        self._P_upper = scipy.sparse.triu(self._P, format="csc")
        self._matrix = scipy.sparse.csc_matrix(rows)
        zero, nonnegative = self._library.ZeroConeT, self._library.NonnegativeConeT
        sizes = ((zero, equalities), (nonnegative, inequalities))
        self._cones = [cone(size) for cone, size in sizes if size]
        self._equalities = equalities

    def _create(self) -> None:
        settings = wrapped.settings_object()
        # Presolve would drop rows, and with them the right to update.
        settings.verbose, settings.presolve_enable = False, False
        self._configure(settings)
        form = self._form
        self._solver = self._library.DefaultSolver(
            self._P_upper, form.q, self._matrix, form.bh, self._cones, settings
        )

    def _send(self) -> None:
        self._solver.update(q=self._form.q, b=self._form.bh)

    def _call(self) -> None:
        self._result = self._solver.solve()

    def _answer(self) -> Solution:
        result = self._result
        detail = str(result.status)
        status = STATUS.get(detail, Status.UNKNOWN)
        iterations, reported_ns = int(result.iterations), round(result.solve_time * 1e9)
        if not status.usable:
            return self._missing(status, detail, iterations, reported_ns)
        dual, count = np.array(result.z), self._equalities
        y, y_box = self._form.two_sided(dual[count:], dual[:count])
        return Solution(status, np.array(result.x), y, y_box, iterations, reported_ns, detail)


ADAPTER = wrapped.ADAPTER.natively(NATIVE, ClarabelWorkspace)
