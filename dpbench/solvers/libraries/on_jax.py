"""qpax and jaxopt's OSQP through qpsolvers; both bring JAX along, hence an extra of their own."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import ClaimedStatus, QpsolversAdapter
from dpbench.solvers.contract import Options
from dpbench.solvers.record import Project, RouteRecord, SolverRecord, by_tolerance, stated

# BoxOSQP.SOLVED, .DUAL_INFEASIBLE, .PRIMAL_INFEASIBLE of jaxopt; 0 is "unsolved", its word for
# a run that ended at the iteration limit.
JAXOPT_STATUS = {
    0: Status.MAX_ITERATIONS,
    1: Status.SOLVED,
    2: Status.DUAL_INFEASIBLE,
    3: Status.PRIMAL_INFEASIBLE,
}

# Of the fields of BoxOSQP, those that say what the problem is or how JAX compiles it.
JAXOPT_STRUCTURE = {"matvec_Q", "matvec_A", "fun", "verbose", "jit", "unroll"}
# The README of qpax; `solve_qp` hands its keywords on without naming them.
QPAX_OPTION_NAMES = ("linear_solver", "max_iter", "solver_tol")
QPAX_MAX_ITER = 30


def read_qpax_status(answer: Any, options: Options) -> ClaimedStatus:
    """Converged or not; when not, the iteration limit is the one reason it knows."""
    iterations = int(answer.extras["info"]["iterations"])
    if bool(answer.found):
        return ClaimedStatus(Status.SOLVED, iterations)
    ended = iterations >= int(str(options.get("max_iter", QPAX_MAX_ITER)))
    return ClaimedStatus(Status.MAX_ITERATIONS if ended else Status.UNKNOWN, iterations)


def read_jaxopt_status(answer: Any, options: Options) -> ClaimedStatus:
    """Status and iterations."""
    status = JAXOPT_STATUS.get(int(answer.extras["status"]), Status.UNKNOWN)
    return ClaimedStatus(status, int(answer.extras["iter_num"]))


def jaxopt_option_names() -> list[str]:
    """List the fields of `jaxopt.BoxOSQP`, to which `jaxopt.OSQP` hands its keywords on."""
    names = inspect.signature(import_module("jaxopt").BoxOSQP).parameters
    return [name for name in names if name not in JAXOPT_STRUCTURE]


def use_double_precision() -> None:
    """JAX computes in single precision unless it is told otherwise."""
    import_module("jax").config.update("jax_enable_x64", True)


def _project(licence: str, name: str) -> Project:
    return stated(
        licence=(licence, f"{name} README"),
        language=("Python on JAX", f"{name} README"),
    )


QPAX = QpsolversAdapter(
    SolverRecord(
        name="qpax",
        family="interior point",
        method="primal-dual interior point on JAX",
        distribution="qpax",
        module="qpax",
        extra="jax",
        form="dense",
        routes={"qpsolvers": RouteRecord(("fresh",), detects_infeasibility=False)},
        # qpax 0.1.4 stalls short of 1e-7 in its own measure: exact answers that it does not claim.
        levels=by_tolerance("solver_tol", max_iter=100),
        project=_project("MIT", "qpax"),
        needs_modules=("jax",),
    ),
    "rows",
    read_qpax_status,
    lambda: QPAX_OPTION_NAMES,
    prepare=use_double_precision,
)
JAXOPT = QpsolversAdapter(
    SolverRecord(
        name="jaxopt",
        family="first order",
        method="operator splitting (ADMM) on JAX",
        distribution="jaxopt",
        module="jaxopt",
        extra="jax",
        form="dense",
        routes={"qpsolvers": RouteRecord(("fresh",), detects_infeasibility=False)},
        levels=by_tolerance("tol", maxiter=100_000),
        project=_project("Apache-2.0", "JAXopt"),
        needs_modules=("jax",),
    ),
    "rows",
    read_jaxopt_status,
    jaxopt_option_names,
    qpsolvers_name="jaxopt_osqp",
    prepare=use_double_precision,
)
