"""PIQP, dense, sparse or by stages: vectors updated, no start; time in seconds."""

from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import (
    Claim,
    QpsolversAdapter,
    make_reader_of_library_info,
    make_reader_of_qpsolvers_status,
)
from dpbench.solvers.contract import (
    NAN_IGNORED,
    RouteRecord,
    SolverRecord,
    find_instruction_set_of_library,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Point

RECORD = SolverRecord(
    name="piqp",
    family="interior point",
    method="proximal interior point",
    distribution="piqp",
    module="piqp",
    extra="core",
    form="dense",
    routes={
        "qpsolvers": RouteRecord(("fresh",), faults=NAN_IGNORED),
        "native": RouteRecord(
            ("fresh", "reuse"),
            updates="vectors",
            two_sided=True,
            refused={"warm": "PIQP has no interface for a starting point"},
            faults=NAN_IGNORED,
        ),
    },
    levels=make_tolerance_presets(
        "eps_abs",
        "eps_duality_gap_abs",
        eps_rel=0.0,
        check_duality_gap=True,
        eps_duality_gap_rel=0.0,
        max_iter=1000,
    ),
    project=make_project_facts(
        licence=("BSD-2-Clause", "PIQP README, Features"),
        language=("C++14, C interface", "PIQP README, Features and Interfaces"),
        allocation_free=("yes, updates and re-solves", "PIQP README, Features"),
    ),
    iteration_limit="max_iter",
    build=lambda: find_instruction_set_of_library("piqp.piqp_python"),
)

STATUS = {
    "PIQP_SOLVED": Status.SOLVED,
    "PIQP_MAX_ITER_REACHED": Status.MAX_ITERATIONS,
    "PIQP_PRIMAL_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "PIQP_DUAL_INFEASIBLE": Status.DUAL_INFEASIBLE,
    "PIQP_NUMERICS": Status.NUMERICAL_ERROR,
    "PIQP_INVALID_SETTINGS": Status.ERROR,
}
read_info = make_reader_of_library_info(
    STATUS, 1e9, word=attrgetter("status.name"), on_request=True
)


THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "native",
    make_reader_of_qpsolvers_status(read_info),
    make_settings=lambda: import_module("piqp").DenseSolver().settings,
)


SPARSE = replace(
    RECORD, name="piqp_sparse", form="csc", routes={"native": RECORD.get_route_record("native")}
)
MULTISTAGE = replace(
    SPARSE,
    name="piqp_multistage",
    method="proximal interior point, factorised stage by stage",
)


class PiqpWorkspace(NativeWorkspace):
    """PIQP with two-sided rows; those with l = u are equalities, and others make it anew."""

    def _prepare_matrices_for_library(self) -> None:
        """Store equal and unequal rows apart, dense or as sparse matrices."""
        as_form = scipy.sparse.csc_matrix if self.form == "csc" else np.asfortranarray
        equal = self._l == self._u
        self._pattern = equal.tobytes()
        self._equal, self._unequal = np.flatnonzero(equal), np.flatnonzero(~equal)
        self._cost = as_form(self._P)
        self._equalities, self._rows = (
            as_form(self._A[rows]) if rows.size else None for rows in (self._equal, self._unequal)
        )

    def _make_piqp_solver(self) -> Any:
        """Return a new PIQP solver, dense or sparse."""
        kind = "SparseSolver" if self.form == "csc" else "DenseSolver"
        return getattr(self._library, kind)()

    def _create_library_solver(self) -> None:
        """Store a new PIQP solver; split the rows again if other rows are equalities."""
        if (self._l == self._u).tobytes() != self._pattern:
            self._prepare_matrices_for_library()
        solver = self._make_piqp_solver()
        solver.settings.verbose = False
        self._set_options_on_library_settings(solver.settings)
        limits = self._name_row_limits_as_piqp_arguments(self._l, self._u)
        b, low, high = (limits.get(name) for name in ("b", "h_l", "h_u"))
        solver.setup(
            self._cost, self._q, self._equalities, b, self._rows, low, high, self._lb, self._ub
        )
        self._solver = solver

    def _name_row_limits_as_piqp_arguments(self, low: Vector, high: Vector) -> dict[str, Vector]:
        """Return row limits by PIQP's names: b of equalities, h_l and h_u of other rows."""
        if not self._equal.size:
            return {"h_l": low, "h_u": high} if self._m else {}
        limits = {"b": low[self._equal]}
        if self._unequal.size:
            limits |= {"h_l": low[self._unequal], "h_u": high[self._unequal]}
        return limits

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass q and row limits to PIQP; make a new solver if other rows are equalities."""
        if (low == high).tobytes() == self._pattern:
            self._solver.update(c=q, **self._name_row_limits_as_piqp_arguments(low, high))
            return
        self._create_library_solver_for_step(q, low, high)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return PIQP's status, iterations and solve time."""
        self._result = self._solver.result
        info = self._result.info
        return read_info(info, info.solve_time, self._options)

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of PIQP's solution and multipliers."""
        result = self._result
        # x is a view of the library's memory.
        z, y, y_box = result.x.copy(), result.z_u - result.z_l, result.z_bu - result.z_bl
        if self._equal.size:
            inequalities, y = y, np.empty(self._m)
            y[self._equal], y[self._unequal] = result.y, inequalities
        return z, y, y_box


class MultistageWorkspace(PiqpWorkspace):
    """PIQP as QP solver, with its stage-wise factorisation for optimal control problems."""

    def _make_piqp_solver(self) -> Any:
        """Return a new sparse PIQP solver that factors stage by stage."""
        solver = super()._make_piqp_solver()
        solver.settings.kkt_solver = self._library.sparse_multistage
        return solver


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(PiqpWorkspace)
NATIVE_SPARSE = replace(NATIVE, record=SPARSE)
NATIVE_MULTISTAGE = replace(NATIVE, record=MULTISTAGE, workspace=MultistageWorkspace)
