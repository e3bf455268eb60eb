"""SCS through its own interface: one-sided, vectors updated, start given or cold."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse

from dpbench.arrays import Vector
from dpbench.qp.solution import Solution
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace, Start
from dpbench.solvers.record import RouteRecord
from dpbench.solvers.through_qpsolvers import scs as wrapped

NATIVE = RouteRecord(
    policies=("fresh", "reuse", "warm"),
    updates="vectors",
    keeps="the scale it has adapted, the normalisation of b and c at its set-up, and the "
    "memory of its acceleration",
    start="primal and dual",
)

STATUS = wrapped.STATUS


class ScsWorkspace(OneSidedWorkspace):
    """SCS on [A; G] z + s = [b; h]; `warm` gives it x, y and the slacks s that go with x."""

    _result: Any

    def _arrange(self) -> None:
        rows, equalities, inequalities = self._rows()
        self._empty = not rows.size
        if self._empty:
            # It wants a cone: one row 0 z ≤ 0 limits nothing.
            rows, inequalities = np.zeros((1, self._n)), 1
        self._dense_rows, self._equalities = rows, equalities
        self._P_upper = scipy.sparse.triu(self._P, format="csc")
        self._matrix = scipy.sparse.csc_matrix(rows)
        self._cone = {"z": equalities, "l": inequalities}
        self._b = np.zeros(1) if self._empty else self._form.bh
        self._y, self._s = np.zeros(rows.shape[0]), np.zeros(rows.shape[0])

    def _create(self) -> None:
        data = {"P": self._P_upper, "A": self._matrix, "b": self._b, "c": self._form.q}
        self._solver = self._library.SCS(data, self._cone, verbose=False, **self._options)
        self._start = Start(self._n, self._m, self._block)
        self._given = False

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        super()._hand_over(q, low, high)
        if self._warm and self._start.advance():
            self._place_start()

    def _send(self) -> None:
        self._solver.update(b=self._b, c=self._form.q)

    def _place_start(self) -> None:
        start = self._start
        self._given = True
        if not self._empty:
            self._form.split(start.y, start.y_box, self._y)
            np.subtract(self._b, self._dense_rows @ start.z, out=self._s)
            np.maximum(self._s, 0.0, out=self._s)
            self._s[: self._equalities] = 0.0

    def _call(self) -> None:
        if self._given:
            self._result = self._solver.solve(True, self._start.z, self._y, self._s)
        else:
            self._result = self._solver.solve(False)

    def _answer(self) -> Solution:
        result = self._result
        info = result["info"]
        detail = str(info["status"])
        status = wrapped.status_of(info)
        iterations, reported_ns = int(info["iter"]), round(info["solve_time"] * 1e6)
        if not status.usable:
            return self._missing(status, detail, iterations, reported_ns)
        count = self._equalities
        if self._empty:
            y, y_box = np.zeros(self._m), np.zeros(self._n)
        else:
            y, y_box = self._form.two_sided(result["y"][count:], result["y"][:count])
        return Solution(status, result["x"].copy(), y, y_box, iterations, reported_ns, detail)

    def _remember(self, solution: Solution) -> None:
        self._start.remember(solution)


ADAPTER = wrapped.ADAPTER.natively(NATIVE, ScsWorkspace)
