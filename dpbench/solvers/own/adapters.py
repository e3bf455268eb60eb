"""Records of dpbench's own solvers; their library is loaded when one is first opened."""

from dataclasses import replace

from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.contract import (
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    Workspace,
    make_project_facts,
    make_tolerance_presets,
)

LICENCE = "Apache-2.0", "dpbench, pyproject.toml"
PAPER_ACTIVE_SET = SolverRecord(
    name="paper_active_set",
    family="active set",
    method="dual active set (eqs. 30 to 32 of the paper), in the form of Goldfarb and Idnani",
    distribution="",
    module="",
    extra="own",
    form="dense",
    routes={
        "native": RouteRecord(
            ("fresh", "reuse", "warm"), updates="vectors", start="active set", two_sided=True
        )
    },
    levels={},
    project=make_project_facts(
        licence=LICENCE,
        language=(
            "C99, without external libraries",
            "dpbench, solvers/own/active_set.h",
        ),
        c_code=("yes (the solver's own source code)", "dpbench, solvers/own/active_set.h"),
        allocation_free=("yes, the caller gives all memory", "dpbench, solvers/own/active_set.h"),
        single_precision=("yes, ACTIVE_SET_FLOAT", "dpbench, solvers/own/active_set.h"),
    ),
    needs_strict_convexity=True,
)
ACTIVE_SET_MEMORY = replace(
    PAPER_ACTIVE_SET,
    name="active_set_memory",
    method="stored affine laws of earlier active sets, otherwise the paper's method",
    project=make_project_facts(
        licence=LICENCE,
        language=("Python around C99", "dpbench, solvers/own/active_set_memory.py"),
    ),
    keeps_answers=True,
    # In Python a stored law takes longer than the paper's method in C: what it saves is iterations.
    choose_instead="paper_active_set",
)
HILDRETH = replace(
    PAPER_ACTIVE_SET,
    name="hildreth",
    family="first order",
    method="dual coordinate ascent (Hildreth 1957), stopped as in Wang's textbook (2009)",
    routes={"native": replace(PAPER_ACTIVE_SET.get_route_record("native"), start="dual")},
    # Sweeps are cheap, and there are problems that take tens of thousands.
    levels=make_tolerance_presets("eps_row", max_iter=1_000_000),
    iteration_limit="max_iter",
)
UNCONSTRAINED_CLIPPED = replace(
    PAPER_ACTIVE_SET,
    name="unconstrained_clipped",
    family="baseline law",
    method="unconstrained law z = −P⁻¹q (paper eq. 27), to be clipped by the loop",
    project=make_project_facts(licence=LICENCE, language=("Python", "dpbench, source")),
    routes={
        "native": RouteRecord(
            ("fresh", "reuse"),
            gives_multipliers=False,
            detects_infeasibility=False,
            refused={"warm": "a direct solve has no starting point"},
        )
    },
)


def _open_paper_active_set_solver(
    record: SolverRecord, policy: Policy, options: Options
) -> Workspace:
    """Return dpbench's solver by the paper's active-set method, which has no options."""
    from dpbench.solvers.own.paper_active_set import PaperActiveSetWorkspace

    return PaperActiveSetWorkspace(record.name, "native", policy)


def _open_solver_with_memory(record: SolverRecord, policy: Policy, options: Options) -> Workspace:
    """Return the paper's method behind a memory of active sets, which has no options."""
    from dpbench.solvers.own.active_set_memory import ActiveSetMemoryWorkspace

    return ActiveSetMemoryWorkspace(record.name, "native", policy)


def _open_hildreth_solver(record: SolverRecord, policy: Policy, options: Options) -> Workspace:
    """Return dpbench's solver by Hildreth's dual method, with the given options."""
    from dpbench.solvers.own.hildreth import HildrethSettings, HildrethWorkspace

    return HildrethWorkspace(record.name, "native", policy, HildrethSettings.from_options(options))


def _open_solver_ignoring_constraints(
    record: SolverRecord, policy: Policy, options: Options
) -> Workspace:
    """Return dpbench's solver that ignores all constraints and has no options."""
    from dpbench.solvers.own.unconstrained import UnconstrainedWorkspace

    return UnconstrainedWorkspace(record.name, "native", policy)


OWN = {
    adapter.record.name: adapter
    for adapter in (
        NativeAdapter(PAPER_ACTIVE_SET, _open_paper_active_set_solver, lambda: ()),
        NativeAdapter(ACTIVE_SET_MEMORY, _open_solver_with_memory, lambda: ()),
        NativeAdapter(
            HILDRETH, _open_hildreth_solver, lambda: ("max_iter", "eps_change", "eps_row")
        ),
        NativeAdapter(UNCONSTRAINED_CLIPPED, _open_solver_ignoring_constraints, lambda: ()),
    )
}
"""Adapters by the name of the solver."""
