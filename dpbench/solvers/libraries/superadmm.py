"""superADMM: one function on l ≤ A z ≤ u, bounds as rows, a start of z and multipliers.

Each call sets the problem up; dense matrices keep nothing for the next call, sparse ones their
ordering.
"""

from importlib import import_module

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, NativeAdapter
from dpbench.solvers.contract import (
    NAN_IGNORED,
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import (
    NativeWorkspace,
    Point,
    append_identity_rows_for_bounds,
)

RECORD = SolverRecord(
    name="superadmm",
    family="first order",
    method="operator splitting (ADMM) with a penalty for each row, adapted at each iteration",
    distribution="superadmm",
    module="superADMM",
    extra="solvers",
    form="dense",
    routes={
        "native": RouteRecord(
            ("fresh", "warm"),
            start="primal and dual",
            two_sided=True,
            refused={
                "reuse": "each call sets the problem up again and keeps nothing of dense matrices"
            },
            faults={
                **NAN_IGNORED,
                "solved despite limits that cross alone": "it does not look for them",
            },
        )
    },
    levels=make_tolerance_presets("eps_abs", eps_rel=0.0, maxIter=10_000),
    project=make_project_facts(
        licence=("LGPL-2.1-or-later", "superADMM, metadata of its distribution"),
        language=("C on BLAS and LAPACK", "superADMM source, superADMM.c"),
        allocation_free=("no, it allocates at each call", "superADMM source, superADMM.c"),
        single_precision=("yes, USE_SINGLE_PRECISION", "superADMM source, superADMM.h"),
    ),
    iteration_limit="maxIter",
    time_limit="timeLimit",
)

STATUS = {
    1: Status.SOLVED,
    2: Status.INACCURATE,  # the tolerance cannot be reached
    0: Status.MAX_ITERATIONS,
    -1: Status.NUMERICAL_ERROR,  # Cholesky failed
    -2: Status.PRIMAL_INFEASIBLE,  # or unbounded: it does not tell these apart
    -3: Status.TIME_LIMIT,
    -4: Status.NUMERICAL_ERROR,  # not convex
}


class SuperadmmWorkspace(NativeWorkspace):
    """superADMM as QP solver; `warm` hands over the previous answer, one increment later."""

    _given: tuple[Vector | None, Vector | None]

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._solve = self._library.superADMM
        self._options["verbose"] = 0

    def _prepare_matrices_for_library(self) -> None:
        """Store P and [A; I], bounds as rows, in superADMM's memory order."""
        self._columns = np.asfortranarray(self._P)
        self._rows = np.asfortranarray(append_identity_rows_for_bounds(self._A, self._n))
        self._low, self._high = self._allocate_limits_of_rows_and_bounds()

    def _create_library_solver(self) -> None:
        """Write the problem's vectors into the arrays of the next call."""
        self._write_vectors_of_next_call(self._q, self._l, self._u)

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Write a step's vectors and the shifted start into the arrays of the next call."""
        self._write_vectors_of_next_call(q, low, high)
        if self._shift_warm_start_if_any():
            self._given = self._start.z, self._start.dual

    def _write_vectors_of_next_call(self, q: Vector, low: Vector, high: Vector) -> None:
        """Write a step's vectors into the arrays of the next call, which has no start."""
        self._cost = q.copy()
        self._low[: self._m], self._high[: self._m] = low, high
        self._given = None, None

    def _call_library_solve(self) -> None:
        """Call superADMM."""
        data = self._columns, self._cost, self._rows, self._low, self._high
        self._result = self._solve(*data, *self._given, self._options)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return superADMM's exit flag, iterations and run time."""
        _, _, flag, info = self._result
        took_ns = round(info["runtime"] * 1e9)
        return STATUS.get(flag, Status.UNKNOWN), info["nIter"], took_ns, f"exit flag {flag}"

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of superADMM's solution and multipliers."""
        z, y, _, _ = self._result
        dual = y.copy()
        return z.copy(), dual[: self._m], dual[self._m :]


def list_options() -> dict[str, object]:
    """Return superADMM's options with their defaults, except `verbose`."""
    options = import_module("superADMM").getOptimOpts()
    return {name: value for name, value in options.items() if name != "verbose"}


NATIVE = NativeAdapter(RECORD, SuperadmmWorkspace, list_options)
