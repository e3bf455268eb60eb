"""Libraries that dpbench runs through qpsolvers alone."""

from dataclasses import replace
from importlib import import_module
from typing import Any

from dpbench.qp.solution import Status
from dpbench.solvers.adapter import (
    ClaimedStatus,
    QpsolversAdapter,
    list_keyword_parameters,
    list_public_settings_attributes,
)
from dpbench.solvers.contract import (
    INFEASIBLE_CALLED_ERROR,
    NAN_FAULTS,
    Options,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)

# Options of cvxopt and kvxopt, from the user guide of CVXOPT, section "Algorithm parameters", and
# the source of `coneqp`: the library has no list of them and ignores unknown ones.
CONE_KEYS = ("abstol", "feastol", "kktreg", "maxiters", "refinement", "reltol", "use_correction")
CONEQP_MAXITERS = 100


def read_coneqp_status(answer: Any, options: Options) -> ClaimedStatus:
    """Return CVXOPT's status and iterations; its "unknown" is an iteration limit or breakdown."""
    name, iterations = str(answer.extras["status"]), int(answer.extras["iterations"])
    if name == "optimal":
        status = Status.SOLVED
    elif iterations >= int(str(options.get("maxiters", CONEQP_MAXITERS))):
        status = Status.MAX_ITERATIONS
    else:
        status = Status.NUMERICAL_ERROR
    return ClaimedStatus(status, iterations, detail=name)


CVXOPT = QpsolversAdapter(
    SolverRecord(
        name="cvxopt",
        family="interior point",
        method="primal-dual interior point with Nesterov-Todd scaling (coneqp)",
        distribution="cvxopt",
        module="cvxopt",
        extra="solvers",
        form="dense",
        routes={
            "qpsolvers": RouteRecord(
                ("fresh", "warm"),
                start="primal",
                detects_infeasibility=False,
                faults=NAN_FAULTS,
            )
        },
        levels=make_tolerance_presets("abstol", "reltol", "feastol", maxiters=200),
        project=make_project_facts(
            licence=("GPL-3.0-or-later", "CVXOPT, Copyright and license"),
            language=("Python and C", "CVXOPT, metadata of its distribution"),
        ),
        iteration_limit="maxiters",
    ),
    "rows",
    read_coneqp_status,
    lambda: CONE_KEYS,
)
# A fork of CVXOPT with the same algorithm.
KVXOPT = replace(
    CVXOPT,
    record=replace(
        CVXOPT.record,
        name="kvxopt",
        choose_instead="cvxopt",
        distribution="kvxopt",
        module="kvxopt",
        project=make_project_facts(
            licence=("GPL-3.0-or-later", "KVXOPT, metadata of its distribution"),
            language=("Python and C", "KVXOPT, metadata of its distribution"),
        ),
    ),
)


ECOS_STATUS = {
    0: Status.SOLVED,
    1: Status.PRIMAL_INFEASIBLE,
    2: Status.DUAL_INFEASIBLE,
    10: Status.INACCURATE,
    11: Status.PRIMAL_INFEASIBLE,
    12: Status.DUAL_INFEASIBLE,
    -1: Status.MAX_ITERATIONS,
    -2: Status.NUMERICAL_ERROR,
    -3: Status.NUMERICAL_ERROR,
    -4: Status.ERROR,
    -7: Status.ERROR,
}
# The README of ecos-python; its C function has no signature and refuses other names.
ECOS_KEYS = (
    "abstol",
    "abstol_inacc",
    "feastol",
    "feastol_inacc",
    "max_iters",
    "nitref",
    "reltol",
    "reltol_inacc",
)


def read_ecos_status(answer: Any, options: Options) -> ClaimedStatus:
    """Return ECOS's status, iterations and run time with set-up from a qpsolvers solution."""
    info = answer.extras
    status = ECOS_STATUS.get(int(info["exitFlag"]), Status.UNKNOWN)
    took_ns = round(info["timing"]["runtime"] * 1e9)
    return ClaimedStatus(status, int(info["iter"]), took_ns, str(info["infostring"]))


ECOS = QpsolversAdapter(
    SolverRecord(
        name="ecos",
        family="interior point",
        method="primal-dual interior point on the equivalent second-order cone program",
        distribution="ecos",
        module="ecos",
        extra="solvers",
        # qpsolvers builds the cone program from dense P and G.
        form="dense",
        routes={"qpsolvers": RouteRecord(("fresh",))},
        levels=make_tolerance_presets("abstol", "reltol", "feastol", max_iters=500),
        project=make_project_facts(
            licence=("GPL-3.0", "ECOS, metadata of its distribution"),
            language=("C", "ECOS README"),
        ),
        iteration_limit="max_iters",
        needs_strict_convexity=True,
    ),
    "rows",
    read_ecos_status,
    lambda: ECOS_KEYS,
)


PYQPMAD = QpsolversAdapter(
    SolverRecord(
        name="pyqpmad",
        family="active set",
        method="dual active set (Goldfarb-Idnani)",
        distribution="pyqpmad",
        module="pyqpmad",
        extra="solvers",
        form="dense",
        routes={
            "qpsolvers": RouteRecord(("fresh",), detects_infeasibility=False, faults=NAN_FAULTS)
        },
        levels={},
        project=make_project_facts(
            licence=("BSD-3-Clause", "pyqpmad, LICENSE of its distribution"),
            language=("C++, header-only on Eigen", "qpmad README"),
            allocation_free=("yes, after reserve", "pyqpmad README, Control Loop Example"),
        ),
        needs_strict_convexity=True,
    ),
    "rows",
    lambda answer, _: ClaimedStatus(Status.SOLVED, int(answer.extras["num_iterations"])),
    make_settings=lambda: import_module("pyqpmad").SolverParameters(),
)


QTQP_STATUS = {
    "solved": Status.SOLVED,
    "almost_solved": Status.INACCURATE,
    "infeasible": Status.PRIMAL_INFEASIBLE,
    "unbounded": Status.DUAL_INFEASIBLE,
    "hit_max_iter": Status.MAX_ITERATIONS,
    "failed": Status.NUMERICAL_ERROR,
}


def read_qtqp_status(answer: Any, options: Options) -> ClaimedStatus:
    """Return QTQP's status from a qpsolvers solution, and iterations if its statistics are on."""
    name, rows = str(answer.extras["status"].value), answer.extras["stats"]
    status = QTQP_STATUS.get(name, Status.UNKNOWN)
    return ClaimedStatus(status, len(rows) if rows else -1, detail=name)


QTQP = QpsolversAdapter(
    SolverRecord(
        name="qtqp",
        family="interior point",
        method="primal-dual interior point, homogeneous embedding, in Python",
        distribution="qtqp",
        module="qtqp",
        extra="solvers",
        form="csc",
        routes={
            "qpsolvers": RouteRecord(
                ("fresh",),
                refused={
                    "warm": "qpsolvers passes no starting point on, and QTQP would need slacks and "
                    "multipliers as well"
                },
            )
        },
        levels=make_tolerance_presets("tol_feas", "tol_gap_abs", "tol_gap_rel", max_iter=500),
        project=make_project_facts(
            licence=("Apache-2.0", "QTQP, metadata of its distribution"),
            language=("Python", "QTQP README"),
        ),
        iteration_limit="max_iter",
    ),
    "rows",
    read_qtqp_status,
    lambda: list_keyword_parameters("qtqp", "QTQP.solve", "self", "verbose", "warm_start"),
)


SIP_STATUS = {
    "SOLVED": Status.SOLVED,
    "SUBOPTIMAL": Status.INACCURATE,
    "LOCALLY_INFEASIBLE": Status.PRIMAL_INFEASIBLE,
    "ITERATION_LIMIT": Status.MAX_ITERATIONS,
    "LINE_SEARCH_ITERATION_LIMIT": Status.NUMERICAL_ERROR,
    "LINE_SEARCH_FAILURE": Status.NUMERICAL_ERROR,
    "TIMEOUT": Status.TIME_LIMIT,
    "FAILED_CHECK": Status.NUMERICAL_ERROR,
    "FACTORIZATION_FAILURE": Status.NUMERICAL_ERROR,
}
SIP_GROUPS = ("barrier", "line_search", "penalty", "regularization", "scaling", "termination")


def read_sip_status(answer: Any, options: Options) -> ClaimedStatus:
    """Return SIP's status and iterations from a qpsolvers solution."""
    info = answer.extras["sip_output"]
    name = info.exit_status.name
    status = SIP_STATUS.get(name, Status.UNKNOWN)
    return ClaimedStatus(status, int(info.num_iterations), detail=name)


def list_sip_options() -> list[str]:
    """Return SIP's option names; members of a settings group as "group.name"."""
    settings = import_module("sip_qp_python").Settings()
    # qpsolvers reads the first three before it looks at SIP's own settings.
    names = ["eps_abs", "eps_rel", "time_limit"]
    names += [
        n
        for n in list_public_settings_attributes(settings.sip)
        if n not in SIP_GROUPS and n != "logging"
    ]
    for group in SIP_GROUPS:
        members = getattr(settings if hasattr(settings, group) else settings.sip, group)
        names += [f"{group}.{name}" for name in list_public_settings_attributes(members)]
    return names


SIP = QpsolversAdapter(
    SolverRecord(
        name="sip",
        family="interior point",
        method="barrier augmented Lagrangian interior point",
        distribution="sip-qp-python",
        module="sip_qp_python",
        extra="solvers",
        form="csc",
        routes={
            "qpsolvers": RouteRecord(("fresh", "warm"), start="primal", detects_infeasibility=False)
        },
        levels=make_tolerance_presets("eps_abs", eps_rel=0.0),
        project=make_project_facts(
            licence=("MIT", "SIP, metadata of its distribution"),
            language=("C++", "SIP QP README"),
            allocation_free=("yes, with Workspace::mem_assign", "SIP QP README"),
        ),
        iteration_limit="max_iterations",
        # It orders its matrices with the AMD of CVXOPT.
        needs_modules=("cvxopt",),
        time_limit="time_limit",
        known_failures={Status.NUMERICAL_ERROR: INFEASIBLE_CALLED_ERROR},
    ),
    "native",
    read_sip_status,
    list_sip_options,
)


# The README of qpax; `solve_qp` hands its keywords on without naming them.
QPAX_KEYS = ("linear_solver", "max_iter", "solver_tol")
QPAX_MAX_ITER = 30


def read_qpax_status(answer: Any, options: Options) -> ClaimedStatus:
    """Return qpax's status and iterations; not solved at the iteration limit is MAX_ITERATIONS."""
    iterations = int(answer.extras["info"]["iterations"])
    if bool(answer.found):
        return ClaimedStatus(Status.SOLVED, iterations)
    ended = iterations >= int(str(options.get("max_iter", QPAX_MAX_ITER)))
    return ClaimedStatus(Status.MAX_ITERATIONS if ended else Status.UNKNOWN, iterations)


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
        levels=make_tolerance_presets("solver_tol", max_iter=100),
        project=make_project_facts(
            licence=("MIT", "qpax README"), language=("Python on JAX", "qpax README")
        ),
        iteration_limit="max_iter",
        needs_modules=("jax",),
    ),
    "rows",
    read_qpax_status,
    lambda: QPAX_KEYS,
    # JAX has single precision by default.
    prepare=lambda: import_module("jax").config.update("jax_enable_x64", True),
)


# BoxOSQP.SOLVED, .DUAL_INFEASIBLE, .PRIMAL_INFEASIBLE of jaxopt; 0 is "unsolved", its word for
# a run that ended at the iteration limit.
JAXOPT_STATUS = {
    0: Status.MAX_ITERATIONS,
    1: Status.SOLVED,
    2: Status.DUAL_INFEASIBLE,
    3: Status.PRIMAL_INFEASIBLE,
}
# Of the fields of BoxOSQP, to which `jaxopt.OSQP` hands its keywords on, those that define the
# problem or how JAX compiles it.
JAXOPT_STRUCTURE = ("matvec_Q", "matvec_A", "fun", "verbose", "jit", "unroll")


def read_jaxopt_status(answer: Any, options: Options) -> ClaimedStatus:
    """Return JAXopt's status and iterations from a qpsolvers solution."""
    status = JAXOPT_STATUS.get(int(answer.extras["status"]), Status.UNKNOWN)
    return ClaimedStatus(status, int(answer.extras["iter_num"]))


JAXOPT = replace(
    QPAX,
    record=replace(
        QPAX.record,
        name="jaxopt",
        family="first order",
        method="operator splitting (ADMM) on JAX",
        distribution="jaxopt",
        module="jaxopt",
        levels=make_tolerance_presets("tol", maxiter=100_000),
        project=make_project_facts(
            licence=("Apache-2.0", "JAXopt README"), language=("Python on JAX", "JAXopt README")
        ),
        iteration_limit="maxiter",
    ),
    read_status=read_jaxopt_status,
    list_options=lambda: list_keyword_parameters("jaxopt", "BoxOSQP", *JAXOPT_STRUCTURE),
    qpsolvers_name="jaxopt_osqp",
)
