"""QOCO through its own interface: one-sided, vectors updated, no start."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse

from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import NativeAdapter, attributes
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace
from dpbench.solvers.record import RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="qoco",
    family="interior point",
    method="primal-dual interior point for second-order cone programs",
    distribution="qoco",
    module="qoco",
    extra="solvers",
    form="csc",
    routes={
        "native": RouteRecord(
            ("fresh", "reuse"),
            updates="vectors",
            detects_infeasibility=False,
            refused={"warm": "QOCO has no interface for a start"},
        )
    },
    levels=by_tolerance("abstol", "reltol", max_iters=500),
    project=stated(
        licence=("BSD-3-Clause", "QOCO README, License"),
        language=("C", "QOCO documentation"),
        c_code=("yes, by QOCOGEN", "QOCOGEN README"),
        allocation_free=("yes, generated code", "QOCOGEN README: static memory allocation only"),
    ),
)

STATUS = {
    "QOCO_SOLVED": Status.SOLVED,
    "QOCO_SOLVED_INACCURATE": Status.INACCURATE,
    "QOCO_NUMERICAL_ERROR": Status.NUMERICAL_ERROR,
    "QOCO_MAX_ITER": Status.MAX_ITERATIONS,
    "QOCO_UNSOLVED": Status.UNKNOWN,
}


class QocoWorkspace(OneSidedWorkspace):
    """QOCO on A z = b, G z ≤ h."""

    _result: Any

    def _arrange(self) -> None:
        form, csc = self._form, scipy.sparse.csc_matrix
        self._matrices = tuple(None if M is None else csc(M) for M in (self._P, form.A, form.G))

    def _create(self) -> None:
        P, A, G = self._matrices
        form = self._form
        inequalities = 0 if form.h is None else form.h.size
        equalities = 0 if form.b is None else form.b.size
        self._solver = self._library.QOCO()
        self._solver.setup(
            self._n,
            inequalities,
            equalities,
            P,
            form.q,
            A,
            form.b,
            G,
            form.h,
            inequalities,
            0,
            None,
            verbose=0,
            **self._options,
        )

    def _send(self) -> None:
        form = self._form
        self._solver.update_vector_data(c=form.q, b=form.b, h=form.h)

    def _call(self) -> None:
        self._result = self._solver.solve()

    def _answer(self) -> Solution:
        result = self._result
        name = str(result.status)
        status = STATUS.get(name, Status.UNKNOWN)
        iterations, reported_ns = int(result.iters), round(result.solve_time_sec * 1e9)
        if not status.usable:
            return self._missing(status, name, iterations, reported_ns)
        y, y_box = self._form.two_sided(np.array(result.z), np.array(result.y))
        return Solution(status, np.array(result.x), y, y_box, iterations, reported_ns, name)


def settings_object() -> Any:
    """QOCO's settings at their defaults."""
    library = import_module("qoco.qoco_ext")
    settings = library.QOCOSettings()
    library.set_default_settings(settings)
    return settings


ADAPTER = NativeAdapter(
    RECORD, QocoWorkspace, lambda: attributes(settings_object()), settings_object
)
