"""qpax and jaxopt's OSQP through qpsolvers; both bring JAX along, hence an extra of their own."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Adapter, ClaimedStatus
from dpbench.solvers.contract import Options
from dpbench.solvers.record import SolverRecord

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
    """The fields of `jaxopt.BoxOSQP`, to which `jaxopt.OSQP` hands its keywords on."""
    names = inspect.signature(import_module("jaxopt").BoxOSQP).parameters
    return [name for name in names if name not in JAXOPT_STRUCTURE]


def use_double_precision() -> None:
    """JAX computes in single precision unless it is told otherwise."""
    import_module("jax").config.update("jax_enable_x64", True)


QPAX = Adapter(
    SolverRecord(
        name="qpax",
        distribution="qpax",
        module="qpax",
        method="primal-dual interior point on JAX",
        extra="jax",
        form="dense",
        box="rows",
        policies={"qpsolvers": ("fresh",)},
        detects_infeasibility=False,
    ),
    read_qpax_status,
    lambda: QPAX_OPTION_NAMES,
    prepare=use_double_precision,
)
JAXOPT = Adapter(
    SolverRecord(
        name="jaxopt",
        distribution="jaxopt",
        module="jaxopt",
        method="operator splitting (ADMM) on JAX",
        extra="jax",
        form="dense",
        box="rows",
        policies={"qpsolvers": ("fresh",)},
        detects_infeasibility=False,
        qpsolvers_name="jaxopt_osqp",
    ),
    read_jaxopt_status,
    jaxopt_option_names,
    prepare=use_double_precision,
)
