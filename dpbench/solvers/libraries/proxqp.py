"""ProxQP (proxsuite) dense or sparse; its status enumeration, time in microseconds.

A start handed to `solve(x, y, z)` has no effect in proxsuite 0.8 (the iterates are those of no
guess at all), and the dense solver with bounds refuses it; its memory of the previous result does
have one, so `warm` shifts that in place under COLD_START_WITH_PREVIOUS_RESULT, which keeps the
iterate and resets the penalties. WARM_START_WITH_PREVIOUS_RESULT, which keeps both, leaves steps
unsolved. After a step it could not solve proxsuite calls every later one infeasible, so anything
but SOLVED makes the next update start from nothing.

Two-sided rows cost it the sight of infeasibility: it runs to its iteration limit where the same
rows in one-sided form, as route qpsolvers hands them over, are found infeasible at once.

Behind qpsolvers its iterations are outer plus inner ones.
"""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Vector
from dpbench.qp.program import rows_per_block
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import (
    Claim,
    NativeAdapter,
    QpsolversAdapter,
    attributes,
    told,
    with_setup,
)
from dpbench.solvers.contract import Options, Policy, shift_into
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Point, stacked
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
    routes={
        "qpsolvers": RouteRecord(("fresh", "warm"), start="primal", faults=NAN_IGNORED),
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            start="primal and dual",
            two_sided=True,
            detects_infeasibility=False,
            faults=NAN_IGNORED,
        ),
    },
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

tell = told(STATUS, 1e3, word=attrgetter("status.name"), on_request=True)

DATA = {"H", "g", "A", "b", "C", "l", "u", "l_box", "u_box", "x", "y", "z", "verbose"}


def keywords() -> list[str]:
    """List the keywords of `proxqp.dense.solve`, whose signature stands in its docstring only."""
    signature = str(import_module("proxsuite").proxqp.dense.solve.__doc__).split("->")[0]
    return [name for name in re.findall(r"[(,] ?(\w+): ", signature) if name not in DATA]


THROUGH_QPSOLVERS = QpsolversAdapter(RECORD, "native", with_setup(tell), keywords)


SPARSE = replace(RECORD, name="proxqp_sparse", form="csc", routes={"native": RECORD.on("native")})


class ProxqpWorkspace(NativeWorkspace):
    """ProxQP with rows l ≤ C x ≤ u; bounds are bounds in its dense and rows in its sparse form."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._library = self._library.proxqp

    def _convert(self) -> None:
        n, m = self._n, self._m
        self._sparse = self.form == "csc"
        self._low, self._high = np.empty(m), np.empty(m)
        if self._sparse:
            self._low, self._high = self._limits_of_all()
            self._H = scipy.sparse.csc_matrix(self._P)
            self._C = scipy.sparse.csc_matrix(stacked(self._A, n))

    def _build(self) -> None:
        n, m, library = self._n, self._m, self._library
        self._low[:m], self._high[:m] = self._l, self._u
        if self._sparse:
            self._solver = library.sparse.QP(n, 0, m + n)
        else:
            self._solver = library.dense.QP(n, 0, m, True)
        self._configure(self._solver.settings)
        if self._sparse:
            self._solver.init(self._H, self._q, None, None, self._C, self._low, self._high)
        else:
            self._solver.init(
                self._P,
                self._q,
                None,
                None,
                self._A,
                self._low,
                self._high,
                self._lb,
                self._ub,
            )
        self._shiftable = self._stuck = False

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        if self._stuck:
            self._build_for(q, low, high)
            return
        m, solver = self._m, self._solver
        self._low[:m], self._high[:m] = low, high
        if self._sparse:
            solver.update(g=q, l=self._low, u=self._high)
        else:
            # Without them the bounds of the previous update would be lost.
            solver.update(g=q, l=self._low, u=self._high, l_box=self._lb, u_box=self._ub)
        if self._shiftable:
            guess = self._library.InitialGuess
            solver.settings.initial_guess = guess.COLD_START_WITH_PREVIOUS_RESULT
            self._shift()

    def _shift(self) -> None:
        block, m, results = self._block, self._m, self._solver.results
        if block:
            x, z, rows = results.x, results.z, rows_per_block(self._n, m, block)
            for part, by in ((x, block), (z[:m], rows), (z[m:], block)):
                shift_into(part, part.copy(), by)

    def _claimed(self) -> Claim:
        self._result = self._solver.results
        info = self._result.info
        claimed = tell(info, info.solve_time, self._options)
        self._stuck = claimed[0] is not Status.SOLVED
        return claimed

    def _point(self) -> Point:
        # Both are views of the library's memory.
        results, m = self._result, self._m
        z, y = results.x.copy(), results.z.copy()
        return z, y[:m], y[m:]

    def _remember(self, solution: Solution) -> None:
        self._shiftable = True


def settings_object() -> Any:
    """ProxQP's settings at their defaults."""
    return import_module("proxsuite").proxqp.dense.QP(1, 0, 0).settings


def option_names() -> list[str]:
    """Its settings but the initial guess, which the policy decides."""
    return [name for name in attributes(settings_object()) if name != "initial_guess"]


NATIVE = NativeAdapter(RECORD, ProxqpWorkspace, option_names, settings_object)
NATIVE_SPARSE = replace(NATIVE, record=SPARSE)
