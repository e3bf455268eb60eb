"""SCS: one-sided, vectors updated, start given or cold; time in milliseconds."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, QpsolversAdapter
from dpbench.solvers.contract import (
    CSettings,
    Options,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.native_workspace import OneSidedWorkspace, Point

RECORD = SolverRecord(
    name="scs",
    family="first order",
    method="operator splitting on the homogeneous embedding, Anderson acceleration",
    distribution="scs",
    module="scs",
    extra="solvers",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(("fresh", "warm"), start="primal"),
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            keeps="the scale it has adapted, the normalisation of b and c at its set-up, and the "
            "memory of its acceleration",
            start="primal and dual",
        ),
    },
    levels=make_tolerance_presets("eps_abs", eps_rel=0.0, max_iters=1_000_000),
    project=make_project_facts(
        licence=("MIT", "SCS, metadata of its distribution"),
        language=("C", "SCS documentation, front page"),
        single_precision=("yes, a flag of its build", "SCS source, scs.mk"),
        c_settings=CSettings("ScsSettings", "scs_set_default_settings", "SCS source, scs.h"),
    ),
    iteration_limit="max_iters",
    time_limit="time_limit_secs",
)

STATUS = {
    1: Status.SOLVED,
    2: Status.INACCURATE,
    -1: Status.DUAL_INFEASIBLE,
    -2: Status.PRIMAL_INFEASIBLE,
    -4: Status.NUMERICAL_ERROR,
    -5: Status.ERROR,
    -6: Status.DUAL_INFEASIBLE,
    -7: Status.PRIMAL_INFEASIBLE,
}

# The page "Settings" of its manual; its C type has no signature to ask and refuses other names.
OPTION_NAMES = (
    "acceleration_interval",
    "acceleration_lookback",
    "adaptive_scale",
    "alpha",
    "eps_abs",
    "eps_infeas",
    "eps_rel",
    "max_iters",
    "normalize",
    "rho_x",
    "scale",
    "time_limit_secs",
)


def convert_scs_info_to_claim(info: Mapping[str, Any], took_ms: float) -> Claim:
    """Return SCS's status, iterations and time in the common form, naming the limit reached."""
    status = STATUS.get(int(info["status_val"]), Status.UNKNOWN)
    # An inaccurate answer names the limit that stopped it in its text.
    if status is Status.INACCURATE and "time_limit" in info["status"]:
        status = Status.TIME_LIMIT
    elif status is Status.INACCURATE and "max_iters" in info["status"]:
        status = Status.MAX_ITERATIONS
    return status, int(info["iter"]), round(took_ms * 1e6), str(info["status"])


def read_scs_status_from_qpsolvers(answer: Any, options: Options) -> Claim:
    """Return SCS's status, iterations and time with set-up from a qpsolvers solution."""
    info = answer.extras
    return convert_scs_info_to_claim(info, info["setup_time"] + info["solve_time"])


THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD, "rows", read_scs_status_from_qpsolvers, lambda: OPTION_NAMES
)


class ScsWorkspace(OneSidedWorkspace):
    """SCS as QP solver, in conic form [A; G] z + s = [b; h]; `warm` gives z, multipliers and s."""

    def _prepare_one_sided_matrices(self) -> None:
        """Store P and stacked rows [A; G] sparse for SCS, with a zero row if there is none."""
        rows, equalities, inequalities = self._stack_equality_and_inequality_rows()
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

    def _create_one_sided_library_solver(self) -> None:
        """Store a new SCS solver made of the QP with A z = b, G z ≤ h."""
        data = {"P": self._P_upper, "A": self._matrix, "b": self._b, "c": self._form.q}
        self._solver = self._library.SCS(data, self._cone, verbose=False, **self._options)
        self._given = False

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's vectors to SCS; convert the warm start into its multipliers and slacks."""
        super()._send_step_vectors_to_library(q, low, high)
        if not self._shift_warm_start_if_any():
            return
        self._given, start = True, self._start
        if not self._empty:
            self._form.write_multipliers_as_one_sided(start.y, start.y_box, self._y)
            np.subtract(self._b, self._dense_rows @ start.z, out=self._s)
            np.maximum(self._s, 0.0, out=self._s)
            self._s[: self._equalities] = 0.0

    def _send_one_sided_vectors_to_library(self) -> None:
        """Pass the linear cost and right-hand sides to SCS."""
        self._solver.update(b=self._b, c=self._form.q)

    def _call_library_solve(self) -> None:
        """Call SCS, with a warm start if there is one, and store its result."""
        if self._given:
            self._result = self._solver.solve(True, self._start.z, self._y, self._s)
        else:
            self._result = self._solver.solve(False)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return SCS's status, iterations and solve time."""
        info = self._result["info"]
        return convert_scs_info_to_claim(info, info["solve_time"])

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of SCS's solution and multipliers."""
        z, y, count = self._result["x"].copy(), self._result["y"], self._equalities
        if self._empty:
            return z, np.zeros(self._m), np.zeros(self._n)
        return z, *self._form.convert_multipliers_to_two_sided(y[count:], y[:count])


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(ScsWorkspace)
