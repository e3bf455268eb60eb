"""DAQP: its `Model` with the active set kept or emptied, or one call for each QP."""

from functools import partial
from importlib import import_module
from math import isfinite
from typing import Any

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.program import QPStep
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import (
    Claim,
    NativeAdapter,
    QpsolversAdapter,
    list_keyword_parameters,
    read_solved_flag_as_claim,
)
from dpbench.solvers.contract import (
    NAN_FAULTS,
    CSettings,
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import SOLVED, NativeWorkspace, Point

RECORD = SolverRecord(
    name="daqp",
    family="active set",
    method="dual active set, LDLᵀ updates of the Gram matrix of the active rows",
    distribution="daqp",
    module="daqp",
    extra="core",
    form="dense",
    routes={
        "qpsolvers": RouteRecord(
            ("fresh", "warm"),
            start="primal",
            detects_infeasibility=False,
            faults=NAN_FAULTS,
        ),
        # A start with the active set shifted by one move goes through `sense`, whose update costs
        # 3 µs; on the paper's sequence it also takes more iterations (1.40) than the set as it was
        # (1.08).
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            start="active set",
            two_sided=True,
            faults=NAN_FAULTS,
        ),
    },
    # dual_tol stays at DAQP's own 1e-12, which is tighter.
    # A semidefinite P it solves by proximal steps, which end by a tolerance of their own.
    levels=make_tolerance_presets("primal_tol", "eta_prox"),
    project=make_project_facts(
        licence=("MIT", "DAQP, metadata of its distribution"),
        language=("C, without external libraries", "DAQP README"),
        c_code=("yes (the solver writes its workspace as C code)", "DAQP source, codegen"),
        allocation_free=("yes, after setup", "DAQP Python interface, docstring of Model"),
        single_precision=("yes, DAQP_SINGLE_PRECISION", "DAQP source, include/types.h"),
        c_settings=CSettings(
            "DAQPSettings", "daqp_default_settings", "DAQP source, include/types.h and api.h"
        ),
    ),
    iteration_limit="iter_limit",
    time_limit="time_limit",
    known_failures={
        Status.SOLVED: "it may violate limits by `primal_tol`, 1e-6 by default, so it claims QPs "
        "solved whose limits miss each other by less"
    },
)

# Keywords of `daqp.solve` that are no options.
DATA = ("H", "f", "A", "bupper", "blower", "sense", "break_points", "is_avi")
STARTS = ("primal_start", "dual_start")
THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "native",
    read_solved_flag_as_claim,
    lambda: list_keyword_parameters("daqp", "solve", *DATA, *STARTS),
)
STATUS = {
    1: Status.SOLVED,
    2: Status.SOLVED,  # soft optimal: no constraint is soft here
    -1: Status.PRIMAL_INFEASIBLE,
    -2: Status.NUMERICAL_ERROR,  # cycling
    -3: Status.DUAL_INFEASIBLE,
    -4: Status.MAX_ITERATIONS,
    -5: Status.NUMERICAL_ERROR,  # nonconvex
    -6: Status.NUMERICAL_ERROR,  # initial active set overdetermined
    -7: Status.TIME_LIMIT,
}


class DaqpWorkspace(NativeWorkspace):
    """DAQP as QP solver; `warm` keeps the active set of the previous solve, `reuse` empties it."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._refused = 0
        self._result = (None, 0.0, 0, {})

    def _prepare_matrices_for_library(self) -> None:
        """Allocate and store DAQP's buffers of bounds, rows and the kinds of constraints."""
        n, m = self._n, self._m
        # DAQP looks at these buffers, so they live as long as the model does.
        self._f = np.empty(n)
        self._low, self._high = np.empty(n + m), np.empty(n + m)
        self._low[:n], self._high[:n] = self._lb, self._ub
        self._low_rows, self._high_rows = self._low[n:], self._high[n:]
        self._sense = np.zeros(n + m, dtype=np.intc)
        # The kinds of constraints, given again, empty its active set.
        sense = None if self._warm else self._sense
        self._vectors = None, self._f, None, self._high, self._low, sense
        self._f_view: Any = self._f.data
        self._low_view: Any = self._low_rows.data
        self._high_view: Any = self._high_rows.data

    def _create_library_solver(self) -> None:
        """Store a new DAQP model and pass it all data."""
        self._f[:], self._low_rows[:], self._high_rows[:] = self._q, self._l, self._u
        self._model = self._library.Model()
        if self._options:
            self._model.settings = self._options
        flag, _ = self._model.setup(self._P, self._f, self._A, self._high, self._low, self._sense)
        self._update, self._solve = self._model.update, self._model.solve
        self._refused = min(flag, 0)
        # A model that refused its problem cannot be updated.
        self._unusable = flag < 0

    def _send_new_matrices_to_library(self) -> bool:
        """Have DAQP take new matrices and bounds; `warm` keeps its active set."""
        n = self._n
        self._low[:n], self._high[:n] = self._lb, self._ub
        self._f[:], self._low_rows[:], self._high_rows[:] = self._q, self._l, self._u
        sense = None if self._warm else self._sense
        flag = self._update(self._P, self._f, self._A, self._high, self._low, sense)
        return bool(flag == 0)

    def update(self, step: QPStep) -> None:
        """Copy a step's vectors into DAQP's arrays by few calls, as DAQP solves in 1.5 µs."""
        new = not (step.P is None and step.A is None and step.lb is None and step.ub is None)
        if new or self._result[2] != 1 or self._unusable or self.setup_every_step:
            super().update(step)
            return
        try:
            # Assigning to a memoryview is faster than NumPy and refuses another shape.
            self._f_view[:] = step.q
            self._low_view[:] = step.l
            self._high_view[:] = step.u
        except (ValueError, TypeError):
            super().update(step)
            return
        self._done = False
        self._refused = self._update(*self._vectors)

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Write a step's cost and row limits into the buffers and have DAQP update them."""
        self._f[:], self._low_rows[:], self._high_rows[:] = q, low, high
        self._refused = self._update(*self._vectors)

    def solve(self) -> None:
        """Call DAQP; if it refused the problem or failed before, keep that as the result."""
        if self._refused or self._failure:
            super().solve()
            return
        self._done = self._unread = self._used = True
        self._result = self._solve()

    def _call_library_solve(self) -> None:
        """Call DAQP; keep the error code if DAQP did not accept the problem."""
        if self._refused:
            self._result = (None, 0.0, self._refused, {"iterations": -1, "solve_time": 0.0})
        else:
            self._result = self._solve()

    def read(self) -> Solution:
        """Return DAQP's answer, by a short path if it is optimal."""
        z, value, flag, info = self._result
        if flag != 1 or not self._done or not isfinite(value):
            return super().read()
        self._unread = False
        dual, n = info["lam"].copy(), self._n
        reported_ns = int(info["solve_time"] * 1e9)
        return Solution(SOLVED, z.copy(), dual[n:], dual[:n], info["iterations"], reported_ns)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return DAQP's exit flag, iterations and solve time."""
        _, _, flag, info = self._result
        status, reported_ns = STATUS.get(flag, Status.UNKNOWN), int(info["solve_time"] * 1e9)
        return status, info["iterations"], reported_ns, f"exit flag {flag}"

    def _copy_solution_and_multipliers(self) -> Point | None:
        """Return solution z and multipliers y, y_box of DAQP's result; None without a point."""
        z, _, _, info = self._result
        if z is None:
            return None
        dual, n = info["lam"].copy(), self._n
        return z.copy(), dual[n:], dual[:n]


class OneShotDaqpWorkspace(DaqpWorkspace):
    """DAQP by one call of `daqp.solve` for each QP: the cold start that costs least.

    A new `Model` for each QP gives the same solution in twice the time.
    """

    def _create_library_solver(self) -> None:
        """Store the call with all data of the QP; the library keeps nothing between calls."""
        self._low_rows[:], self._high_rows[:] = self._l, self._u
        bounds = self._high, self._low, self._sense
        self._solve = partial(
            self._library.solve, self._P, self._q, self._A, *bounds, **self._options
        )

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Do nothing: the call that was stored before looks at the step's vectors."""


def _open_workspace(record: SolverRecord, policy: Policy, options: Options) -> DaqpWorkspace:
    """Return a workspace of one call for each QP for `fresh`, of a `Model` otherwise."""
    kind = OneShotDaqpWorkspace if policy == "fresh" else DaqpWorkspace
    return kind(record, policy, options)


NATIVE = NativeAdapter(
    RECORD, _open_workspace, lambda: dict(import_module("daqp").Model().settings)
)
