"""OSQP: its extension module, vectors updated, start given or cold; time in seconds."""

from importlib import import_module
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Vector
from dpbench.errors import DpbenchError
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import (
    Claim,
    QpsolversAdapter,
    list_public_settings_attributes,
    make_reader_of_library_info,
    make_reader_of_qpsolvers_status,
)
from dpbench.solvers.contract import (
    ABOVE_ZERO,
    DEFAULT,
    HIGH,
    ZERO_OR_MORE,
    Build,
    CSettings,
    Options,
    Policy,
    Range,
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

# OSQP 1.x adapts ρ by iterations by default, earlier releases did by the clock.
_LEVELS = make_tolerance_presets(
    "eps_abs",
    eps_rel=0.0,
    max_iter=200_000,
    always={"adaptive_rho": 1, "adaptive_rho_interval": 50},
)
# As in `validate_settings` of OSQP 1.0.
_RANGES = {
    **dict.fromkeys(("rho", "sigma", "delta", "max_iter", "time_limit"), ABOVE_ZERO),
    **dict.fromkeys(("eps_prim_inf", "eps_dual_inf", "adaptive_rho_fraction"), ABOVE_ZERO),
    **dict.fromkeys(("eps_abs", "eps_rel", "scaling", "check_termination"), ZERO_OR_MORE),
    **dict.fromkeys(("adaptive_rho_interval", "polish_refine_iter"), ZERO_OR_MORE),
    "adaptive_rho_tolerance": Range("1 or more", lambda value: value >= 1),
    "alpha": Range("above 0 and below 2", lambda value: 0 < value < 2),
}
# Polishing is a second algorithm with silent failures, so it has names of its own.
_POLISHED = {f"{name}_polished": {**_LEVELS[name], "polishing": True} for name in (DEFAULT, HIGH)}


def _list_policy_options(policy: Policy) -> Options:
    """Return the settings that a policy sets."""
    return {"warm_starting": policy == "warm"}


RECORD = SolverRecord(
    name="osqp",
    family="first order",
    method="operator splitting (ADMM)",
    distribution="osqp",
    module="osqp",
    extra="core",
    form="csc",
    routes={
        "qpsolvers": RouteRecord(("fresh", "warm"), start="primal"),
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            keeps="the step size ρ it has adapted, and the scale of the cost from its set-up",
            start="primal and dual",
            two_sided=True,
        ),
    },
    levels={**_LEVELS, **_POLISHED},
    project=make_project_facts(
        licence=("Apache-2.0", "OSQP, metadata of its distribution"),
        language=("C, without external libraries", "OSQP web site, Features"),
        c_code=(
            "yes (the library generates it for a problem)",
            "OSQP web site, Features: Embeddable",
        ),
        allocation_free=("yes, generated code", "OSQP web site, Features: no memory manager"),
        single_precision=("yes, OSQP_USE_FLOAT", "OSQP source, osqp_api_types.h"),
        c_settings=CSettings(
            "OSQPSettings",
            "osqp_set_default_settings",
            "OSQP source, osqp_api_types.h",
            list_policy_options=_list_policy_options,
            warm_start="osqp_warm_start",
        ),
    ),
    iteration_limit="max_iter",
    adapted={"rho": "adaptive_rho"},
    ranges=_RANGES,
    one_above_zero=("eps_abs", "eps_rel"),
    build=lambda: Build(f"algebra {import_module('osqp').default_algebra()}"),
    time_limit="time_limit",
)

STATUS = {
    1: Status.SOLVED,
    2: Status.INACCURATE,
    3: Status.PRIMAL_INFEASIBLE,
    4: Status.PRIMAL_INFEASIBLE,
    5: Status.DUAL_INFEASIBLE,
    6: Status.DUAL_INFEASIBLE,
    7: Status.MAX_ITERATIONS,
    8: Status.TIME_LIMIT,
    9: Status.NUMERICAL_ERROR,
    10: Status.ERROR,
}
read_info = make_reader_of_library_info(STATUS, 1e9, number=lambda info: int(info.status_val))


def make_default_settings_of_library() -> Any:
    """Return OSQP's default settings."""
    library = import_module("osqp.ext_builtin")
    settings = library.OSQPSettings()
    library.osqp_set_default_settings(settings)
    return settings


def make_settings_of_workspace(policy: Policy, options: Options) -> Any:
    """Return OSQP's settings object with what a policy and options set."""
    settings = make_default_settings_of_library()
    settings.verbose = False
    for name, value in {**_list_policy_options(policy), **options}.items():
        setattr(settings, name, value)
    return settings


def format_osqp_call(policy: Policy, options: Options) -> str:
    """Return Python code that calls OSQP with the settings that the workspace passes."""
    settings, usual = (
        make_settings_of_workspace(policy, options),
        make_default_settings_of_library(),
    )
    names = ["verbose", *list_public_settings_attributes(settings), "warm_starting"]
    given = {"verbose", *_list_policy_options(policy), *options}
    own = [
        name for name in names if name in given or getattr(settings, name) != getattr(usual, name)
    ]
    arguments = ", ".join(f"{name}={getattr(settings, name)!r}" for name in own)
    step = {
        "fresh": "# Each step: a new OSQP object.",
        "reuse": "# Each step: m.update(q=q, l=l, u=u), m.solve(raise_error=False)",
        "warm": "# Each step: m.update(q=q, l=l, u=u), m.warm_start(x=x, y=y) with the previous\n"
        "# answer shifted by one control increment, m.solve(raise_error=False). The last blocks\n"
        "# of x, of y for the rows of A and of y for the bounds are then zero.",
    }[policy]
    if policy != "fresh":
        step += (
            "\n# New P or A: also update(Px=..., Ax=...) with the same nonzeros, or a new setup."
        )
    cost = "q" if policy == "fresh" else "0 * q"
    arrays = "# P and A: sparse matrices (scipy.sparse.csc_matrix)."
    if policy != "fresh":
        arrays += (
            " q, l and u: contiguous arrays\n"
            "# (numpy.ascontiguousarray). Rows of arrays from scipy.io.loadmat are not: update\n"
            "# reads wrong numbers of them without a message."
        )
    setup = f"m = osqp.OSQP()\nm.setup(P, {cost}, A, l, u, {arguments})"
    return f"{arrays}\nimport osqp\n{setup}\n{step}"


# Without raise_error, osqp 1.1 raises a warning at every solve.
THROUGH_QPSOLVERS = QpsolversAdapter(
    RECORD,
    "rows",
    make_reader_of_qpsolvers_status(read_info),
    make_settings=make_default_settings_of_library,
    fixed={"raise_error": False},
)


INFINITY = 1e30  # OSQP_INFTY


class OsqpWorkspace(NativeWorkspace):
    """OSQP as QP solver, bounds as rows; `reuse` keeps factors and step size ρ, starts at zero."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._library = import_module("osqp.ext_builtin")

    def _prepare_matrices_for_library(self) -> None:
        """Store sparse P and [A; I], bounds as rows, for OSQP, and arrays of limits."""
        n, m = self._n, self._m
        self._sparse = self._convert_matrices_to_csc()
        self._low, self._high = np.empty(m + n), np.empty(m + n)
        np.maximum(self._lb, -INFINITY, out=self._low[m:])
        np.minimum(self._ub, INFINITY, out=self._high[m:])
        self._low_rows, self._high_rows = self._low[:m], self._high[:m]

    def _convert_matrices_to_csc(self) -> tuple[Any, Any]:
        """Return the upper triangle of P and the rows [A; I] as sparse matrices."""
        rows = append_identity_rows_for_bounds(self._A, self._n)
        return scipy.sparse.triu(self._P, format="csc"), scipy.sparse.csc_matrix(rows)

    def _send_new_matrices_to_library(self) -> bool:
        """Pass the values of new matrices, with bounds, to OSQP if their pattern is the old one."""
        new = self._convert_matrices_to_csc()
        for old, other in zip(self._sparse, new, strict=True):
            if not np.array_equal(old.indptr, other.indptr):
                return False
            if not np.array_equal(old.indices, other.indices):
                return False
        self._sparse, m = new, self._m
        np.maximum(self._lb, -INFINITY, out=self._low[m:])
        np.minimum(self._ub, INFINITY, out=self._high[m:])
        return not self._solver.update_data_mat(
            P_x=new[0].data, P_i=None, A_x=new[1].data, A_i=None
        )

    def _write_clipped_row_limits(self, low: Vector, high: Vector) -> None:
        """Write row limits into OSQP's arrays, clipped to ±1e30, which OSQP takes as infinite."""
        np.maximum(low, -INFINITY, out=self._low_rows)
        np.minimum(high, INFINITY, out=self._high_rows)

    def _create_library_solver(self) -> None:
        """Store a new OSQP solver made of all data and options."""
        settings = make_settings_of_workspace(self.policy, self._options)
        self._write_clipped_row_limits(self._l, self._u)
        n, m = self._n, self._m
        P_upper, rows = map(self._library.CSC, self._sparse)
        self._solver = self._library.OSQPSolver(
            P_upper, self._q, rows, self._low, self._high, m + n, n, settings
        )
        # A view of the latest answer. Each look at `solution` makes another one of 32 B, which
        # osqp 1.0 never frees.
        self._solution = self._solver.solution

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's cost, limits and shifted warm start to OSQP."""
        self._write_clipped_row_limits(low, high)
        if self._solver.update_data_vec(q=q, l=self._low, u=self._high):
            raise DpbenchError("OSQP refuses the vectors: a lower limit is above the upper one")
        if self._shift_warm_start_if_any():
            self._solver.warm_start(self._start.z, self._start.dual)

    def _read_status_iterations_and_time(self) -> Claim:
        """Return OSQP's status, iterations and solve time."""
        info = self._solver.info
        return read_info(info, info.solve_time, self._options)

    def _copy_solution_and_multipliers(self) -> Point:
        """Return copies of OSQP's solution and multipliers."""
        solution, m = self._solution, self._m
        z, y = solution.x, solution.y  # copies, made by the library's interface
        return z, y[:m], y[m:]


NATIVE = THROUGH_QPSOLVERS.make_native_adapter(OsqpWorkspace, format_osqp_call)
