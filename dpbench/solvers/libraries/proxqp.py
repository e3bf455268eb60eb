"""ProxQP (proxsuite) dense or sparse; its status enumeration, time in microseconds.

A start handed to `solve(x, y, z)` has no effect in proxsuite 0.8, and the dense solver with bounds
refuses it; its memory of the previous result has one, so `warm` shifts that in place under
COLD_START_WITH_PREVIOUS_RESULT, which keeps the iterate and resets the penalties.
WARM_START_WITH_PREVIOUS_RESULT, which keeps both, leaves steps unsolved. After a step it could not
solve proxsuite reports every later one as infeasible, so anything but SOLVED makes the next update
start from nothing. With two-sided rows it runs to its iteration limit where the same rows in
one-sided form, on route qpsolvers, are found infeasible at once.

Behind qpsolvers its iterations are outer plus inner ones.
"""

import re
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Vector
from dpbench.qp.program import count_rows_per_block
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import (
    Claim,
    NativeAdapter,
    QpsolversAdapter,
    list_public_settings_attributes,
    make_reader_of_library_info,
    make_reader_of_qpsolvers_status,
)
from dpbench.solvers.contract import (
    NAN_IGNORED,
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    find_instruction_set_of_library,
    make_project_facts,
    make_tolerance_presets,
    shift_into,
)
from dpbench.solvers.libraries.native_workspace import (
    NativeWorkspace,
    Point,
    append_identity_rows_for_bounds,
)

RECORD = SolverRecord(
    name="proxqp",
    family="augmented Lagrangian",
    method="proximal augmented Lagrangian with semismooth Newton steps",
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
    levels=make_tolerance_presets(
        "eps_abs",
        "eps_duality_gap_abs",
        eps_rel=0.0,
        check_duality_gap=True,
        eps_duality_gap_rel=0.0,
    ),
    project=make_project_facts(
        licence=("BSD-2-Clause", "ProxSuite documentation, What is ProxSuite?"),
        language=("C++14", "ProxSuite README, main features"),
    ),
    iteration_limit="max_iter",
    limits_outer_iterations=True,
    build=lambda: find_instruction_set_of_library("proxsuite.proxsuite_pywrap"),
)

# "Closest feasible" means that the problem has no feasible point and a shifted one was solved.
STATUS = {
    "PROXQP_SOLVED": Status.SOLVED,
    "PROXQP_MAX_ITER_REACHED": Status.MAX_ITERATIONS,
    "PROXQP_PRIMAL_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PROXQP_DUAL_INFEASIBLE": Status.DUAL_INFEASIBLE,
}

read_info = make_reader_of_library_info(
    STATUS, 1e3, word=attrgetter("status.name"), on_request=True
)

DATA = {"H", "g", "A", "b", "C", "l", "u", "l_box", "u_box", "x", "y", "z", "verbose"}


def list_qpsolvers_keywords_of_proxqp() -> list[str]:
    """Return the option names of `proxqp.dense.solve`, parsed from its docstring."""
    signature = str(import_module("proxsuite").proxqp.dense.solve.__doc__).split("->")[0]
    return [name for name in re.findall(r"[(,] ?(\w+): ", signature) if name not in DATA]


THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD, "native", make_reader_of_qpsolvers_status(read_info), list_qpsolvers_keywords_of_proxqp
)


SPARSE = replace(
    RECORD, name="proxqp_sparse", form="csc", routes={"native": RECORD.get_route_record("native")}
)


class ProxqpWorkspace(NativeWorkspace):
    """ProxQP as QP solver with two-sided rows; dense, or sparse with bounds as rows."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._library = self._library.proxqp

    def _prepare_matrices_for_library(self) -> None:
        """Store arrays of limits; in the sparse form also P and [A; I], bounds as rows."""
        n, m = self._n, self._m
        self._sparse = self.form == "csc"
        self._low, self._high = np.empty(m), np.empty(m)
        if self._sparse:
            self._low, self._high = self._allocate_limits_of_rows_and_bounds()
            self._H = scipy.sparse.csc_matrix(self._P)
            self._C = scipy.sparse.csc_matrix(append_identity_rows_for_bounds(self._A, n))

    def _create_library_solver(self) -> None:
        """Store a new ProxQP solver, dense or sparse, made of all data and options."""
        n, m, library = self._n, self._m, self._library
        self._low[:m], self._high[:m] = self._l, self._u
        sparse, dense = library.sparse.QP, library.dense.QP
        self._solver = sparse(n, 0, m + n) if self._sparse else dense(n, 0, m, True)
        self._set_options_on_library_settings(self._solver.settings)
        if self._sparse:
            self._solver.init(self._H, self._q, None, None, self._C, self._low, self._high)
        else:
            limits = self._low, self._high, self._lb, self._ub
            self._solver.init(self._P, self._q, None, None, self._A, *limits)
        self._shiftable = self._stuck = False

    def _send_new_matrices_to_library(self) -> bool:
        """Pass new matrices and bounds to ProxQP; the sparse form takes those of one pattern."""
        if self._sparse or self._stuck:
            return False
        self._solver.update(H=self._P, C=self._A, l_box=self._lb, u_box=self._ub)
        return True

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass q and limits to ProxQP; shift its previous result in place as warm start."""
        if self._stuck:
            self._create_library_solver_for_step(q, low, high)
            return
        m, solver = self._m, self._solver
        self._low[:m], self._high[:m] = low, high
        # Without them the bounds of the previous update would be lost.
        bounds = {} if self._sparse else {"l_box": self._lb, "u_box": self._ub}
        solver.update(g=q, l=self._low, u=self._high, **bounds)
        if self._shiftable:
            guess = self._library.InitialGuess
            solver.settings.initial_guess = guess.COLD_START_WITH_PREVIOUS_RESULT
            if block := self._block:
                x, z, rows = (
                    solver.results.x,
                    solver.results.z,
                    count_rows_per_block(self._n, m, block),
                )
                for part, by in ((x, block), (z[:m], rows), (z[m:], block)):
                    shift_into(part, part.copy(), by)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return ProxQP's status and iterations; note a failure after which it is made anew."""
        self._result = self._solver.results
        info = self._result.info
        claimed = read_info(info, info.solve_time, self._options)
        self._stuck = claimed[0] is not Status.SOLVED
        return claimed

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of ProxQP's solution and multipliers."""
        # Both are views of the library's memory.
        results, m = self._result, self._m
        z, y = results.x.copy(), results.z.copy()
        return z, y[:m], y[m:]

    def _store_answer_as_warm_start(self, solution: Solution) -> None:
        """Note that ProxQP's own last result can be shifted as a warm start."""
        self._shiftable = True


def make_default_settings_of_library() -> Any:
    """Return ProxQP's default settings."""
    return import_module("proxsuite").proxqp.dense.QP(1, 0, 0).settings


def list_proxqp_settings() -> list[str]:
    """Return the names of ProxQP's settings, except the initial guess."""
    return [
        name
        for name in list_public_settings_attributes(make_default_settings_of_library())
        if name != "initial_guess"
    ]


NATIVE = NativeAdapter(
    RECORD, ProxqpWorkspace, list_proxqp_settings, make_default_settings_of_library
)
NATIVE_SPARSE = replace(NATIVE, record=SPARSE)
