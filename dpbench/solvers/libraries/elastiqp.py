"""ElastiQP: dual active set or augmented Lagrangian on rows relaxed with an L1 penalty, one-sided.

    min ½ zᵀPz + qᵀz + w Σ max(G z − h, 0),  A z = b

A row whose multiplier is at w is saturated: its limit is given up. Such an answer solves another
problem than the one asked, so it is inaccurate here, whatever the library's status.
"""

from dataclasses import replace
from functools import partial
from importlib import import_module

import numpy as np

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, NativeAdapter, list_public_settings_attributes
from dpbench.solvers.contract import (
    NAN_FAULTS,
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace, Point

PENALTY = 1e6
"""Penalty w: 600 times the largest multiplier of the stored sequences, in scaled units."""
NO_MULTIPLIERS = np.empty(0)

RECORD = SolverRecord(
    name="elastiqp",
    family="active set",
    method="dual active set on rows relaxed with an L1 penalty, after DAQP",
    distribution="elastiqp",
    module="elastiqp",
    extra="solvers",
    form="dense",
    routes={
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            start="active set",
            detects_infeasibility=False,
            faults=NAN_FAULTS,
        )
    },
    levels=make_tolerance_presets("eps_abs"),
    project=make_project_facts(
        licence=("Apache-2.0", "ElastiQP, metadata of its distribution"),
        language=("C++, header-only on Eigen", "ElastiQP README, Overview"),
        allocation_free=("yes, up to some 160 variables", "ElastiQP source, test_das_alloc.cc"),
    ),
    iteration_limit="max_iter",
)
PDAL_RECORD = replace(
    RECORD,
    name="elastiqp_pdal",
    choose_instead="elastiqp",
    family="augmented Lagrangian",
    method="primal-dual augmented Lagrangian on rows relaxed with an L1 penalty, after ProxQP",
    routes={
        "native": replace(RECORD.get_route_record("native"), start="primal and dual", faults={})
    },
    project=replace(
        RECORD.project, allocation_free=make_project_facts(licence=None, language=None).licence
    ),
    iteration_limit="max_outer_iter",
    limits_outer_iterations=True,
)

STATUS = {
    "Solved": Status.SOLVED,
    "MaxIter": Status.MAX_ITERATIONS,
    "Infeasible": Status.PRIMAL_INFEASIBLE,
    "Numerics": Status.NUMERICAL_ERROR,
}


class ElastiqpWorkspace(OneSidedWorkspace):
    """ElastiQP as QP solver; `warm` starts from what the library keeps of the previous solve."""

    def __init__(
        self, backend: str, record: SolverRecord, policy: Policy, options: Options
    ) -> None:
        super().__init__(record, policy, options)
        self._library = getattr(self._library, backend)
        self._penalty = float(str(self._options.pop("penalty", PENALTY)))
        # Handing over a start makes it factorise the working set again.
        self._given_start = False

    def _prepare_one_sided_matrices(self) -> None:
        """Store P, A and G in ElastiQP's memory order."""
        form, none = self._form, np.empty((0, self._n))
        self._P_columns = np.asfortranarray(self._P)
        self._G_columns = np.asfortranarray(none if form.G is None else form.G)
        self._A_columns = None if form.A is None else np.asfortranarray(form.A)
        self._h = np.empty(0) if form.h is None else form.h

    def _create_one_sided_library_solver(self) -> None:
        """Store a new ElastiQP solver made of the QP with A z = b, G z ≤ h, and all options."""
        form = self._form
        self._solver = self._library.Solver()
        settings = self._library.Settings()
        settings.warm_start = self._warm
        self._set_options_on_library_settings(settings)
        self._solver.settings = settings
        data = self._P_columns, form.q, self._G_columns, self._h, self._penalty
        self._solver.setup(*data, A=self._A_columns, b=form.b)

    def _send_one_sided_vectors_to_library(self) -> None:
        """Pass the linear cost and right-hand sides to ElastiQP."""
        form, solver = self._form, self._solver
        solver.set_q(form.q)
        solver.set_h(self._h)
        if form.b is not None:
            solver.set_b(form.b)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return ElastiQP's status and iterations; INACCURATE where limits are given up."""
        result = self._result
        status, saturated = STATUS.get(result.status.name, Status.UNKNOWN), result.n_saturated
        if status is Status.SOLVED and saturated:
            return Status.INACCURATE, result.iters, -1, f"saturated rows: {saturated}"
        return status, result.iters, -1, result.status.name

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of ElastiQP's solution and multipliers."""
        # The library's interface makes each of them a new array, which takes 2 µs.
        result = self._result
        y = NO_MULTIPLIERS if self._form.b is None else result.y
        return result.x, *self._form.convert_multipliers_to_two_sided(result.z, y)


def make_adapter(record: SolverRecord, backend: str) -> NativeAdapter:
    """Return the adapter of one of ElastiQP's methods, "das" or "pdal"."""

    def list_options() -> dict[str, object]:
        settings = getattr(import_module("elastiqp"), backend).Settings()
        names = list_public_settings_attributes(settings)
        kept = (name for name in names if name != "warm_start")
        return {name: getattr(settings, name) for name in kept} | {"penalty": PENALTY}

    return NativeAdapter(record, partial(ElastiqpWorkspace, backend), list_options)


NATIVE = make_adapter(RECORD, "das")
NATIVE_PDAL = make_adapter(PDAL_RECORD, "pdal")
