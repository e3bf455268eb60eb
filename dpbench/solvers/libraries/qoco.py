"""QOCO through its own interface: one-sided, vectors updated, no start."""

from importlib import import_module
from typing import Any

import numpy as np
import scipy

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, NativeAdapter
from dpbench.solvers.contract import (
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace, Point

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
            refused={"warm": "QOCO has no interface for a starting point"},
        )
    },
    levels=make_tolerance_presets("abstol", "reltol", max_iters=500),
    project=make_project_facts(
        licence=("BSD-3-Clause", "QOCO README, License"),
        language=("C", "QOCO documentation"),
        c_code=("yes (QOCOGEN generates it for a problem)", "QOCOGEN README"),
        allocation_free=("yes, generated code", "QOCOGEN README: static memory allocation only"),
    ),
    iteration_limit="max_iters",
)

STATUS = {
    "QOCO_SOLVED": Status.SOLVED,
    "QOCO_SOLVED_INACCURATE": Status.INACCURATE,
    "QOCO_NUMERICAL_ERROR": Status.NUMERICAL_ERROR,
    "QOCO_MAX_ITER": Status.MAX_ITERATIONS,
}


class QocoWorkspace(OneSidedWorkspace):
    """QOCO as QP solver, on A z = b and G z ≤ h."""

    def _prepare_one_sided_matrices(self) -> None:
        """Store P, A and G as sparse matrices for QOCO."""
        form, csc = self._form, scipy.sparse.csc_matrix
        self._matrices = tuple(None if M is None else csc(M) for M in (self._P, form.A, form.G))

    def _create_one_sided_library_solver(self) -> None:
        """Store a new QOCO solver made of the QP with A z = b, G z ≤ h."""
        P, A, G = self._matrices
        form = self._form
        inequalities = 0 if form.h is None else form.h.size
        equalities = 0 if form.b is None else form.b.size
        self._solver = self._library.QOCO()
        data = P, form.q, A, form.b, G, form.h
        sizes, cones = (self._n, inequalities, equalities), (inequalities, 0, None)
        self._solver.setup(*sizes, *data, *cones, verbose=0, **self._options)
        # A view of the latest answer. Each look at `solution` makes another one of 32 B, which
        # qoco 0.3 never frees; its own `solve()` looks 14 times.
        self._result = self._solver._solver.solution

    def _send_one_sided_vectors_to_library(self) -> None:
        """Pass the linear cost and right-hand sides to QOCO."""
        form = self._form
        self._solver.update_vector_data(c=form.q, b=form.b, h=form.h)

    def _call_library_solve(self) -> None:
        """Call QOCO's solve function."""
        self._solver._solver.solve()

    def _read_status_iterations_and_time(self) -> Claim:
        """Return QOCO's status, iterations and solve time."""
        result = self._result
        name = self._solver.solvecodes[result.status]
        took_ns = round(result.solve_time_sec * 1e9)
        return STATUS.get(name, Status.UNKNOWN), int(result.iters), took_ns, name

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of QOCO's solution and multipliers."""
        result = self._result
        duals = np.array(result.z), np.array(result.y)
        return np.array(result.x), *self._form.convert_multipliers_to_two_sided(*duals)


def make_default_settings_of_library() -> Any:
    """Return QOCO's default settings."""
    library = import_module("qoco.qoco_ext")
    settings = library.QOCOSettings()
    library.set_default_settings(settings)
    return settings


NATIVE = NativeAdapter(RECORD, QocoWorkspace, make_settings=make_default_settings_of_library)
