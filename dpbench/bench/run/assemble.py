"""Assembly of runs: closed loop or replay, raw log and timed solver, from a cell or sequence."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

from dpbench.bench.record.cell import Cell, Formulation
from dpbench.bench.record.raw_log import (
    AnswerLog,
    Layout,
    RawLog,
    make_loop_layout,
    make_replay_layout,
)
from dpbench.bench.run.backup import Backup
from dpbench.bench.run.closed_loop import ClosedLoopSetup
from dpbench.bench.run.exact_loop import build_problem_at_rest
from dpbench.bench.run.formulation import (
    BoxFormulation,
    Case,
    QPBuilder,
    build_loop_formulation,
    formulate_sequence,
)
from dpbench.bench.run.slow_computer import make_delay_of_cell, read_process_usage
from dpbench.bench.run.timed_solver import STEP_SHARE, ResumedSolver, TimedSolver
from dpbench.errors import InputError, UnknownNameError
from dpbench.qp.program import QPSequence
from dpbench.scenario.plants.contract import PlantMaker
from dpbench.scenario.plants.linear_mpc import LinearMPC
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Route, Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import find_solver_record

NO_LIMIT_NS = 2**62
NewLog = Callable[[Layout], RawLog]
clock = time.perf_counter_ns


def build_closed_loop_setup(
    cell: Cell,
    scenario: Case,
    workspace: Workspace,
    new_log: NewLog,
    limit_ns: int,
    *,
    hung: Sequence[int] = (),
    plant: PlantMaker | None = None,
) -> ClosedLoopSetup:
    """Build what a closed-loop run needs: QP builder, timed solver, log, backup, time limits.

    `hung` are steps in which an earlier process hung, whose log `new_log` opens; for a step that is
    there twice, the backup and the second solver of a cascade hung too. `plant` makes a custom
    plant, which replaces the scenario's ship. InputError for "sparse" without stages, an impossible
    delay, or a backup or second workspace that cannot be opened.
    """
    scenario = adapt_scenario_to_cell(cell, scenario)
    delay = make_delay_of_cell(cell, scenario.sample_s)
    why = scenario.controller.why_no_delay
    if delay.is_simulated and why:
        raise InputError("closed loop", "slowdown", cell.slowdown, f"0 for {why}")
    builder = QPBuilder(scenario, cell.units, sparse=cell.formulation == "sparse")
    layout = make_loop_layout(
        scenario.steps,
        *builder.sizes,
        backup=bool(cell.backup),
        states=builder.states,
        inputs=builder.inputs,
    )
    log = new_log(layout)
    formulated = build_loop_formulation(
        cell.formulation, builder, build_problem_at_rest(builder.condensed)
    )
    last = hung[-1] if hung else None
    twice = [k for k in hung if hung.count(k) > 1]

    def build_solver(
        workspace: Workspace, form: BoxFormulation, answers: AnswerLog, *, skips: bool = True
    ) -> TimedSolver:
        if last is None:
            return TimedSolver(workspace, form, clock)
        return ResumedSolver(
            workspace, form, clock, answers=answers, at=last, skips=skips, limit_ns=limit_ns
        )

    solver = build_solver(workspace, formulated, log)
    setup = ClosedLoopSetup(
        scenario, builder, solver, log, cell.fallback, limit_ns, clock, delay, read_process_usage
    )
    setup.plant = plant
    if log.backup is not None:
        limit_s = None if limit_ns == NO_LIMIT_NS else STEP_SHARE * limit_ns * 1e-9
        second_solver = TimedSolver(open_backup_workspace(cell.backup, limit_s), formulated, clock)
        setup.backup = Backup(
            second_solver, builder.condensed.moves, log.backup, hung=twice, limit_ns=limit_ns
        )
    if builder.allocation is not None and log.allocation is not None:
        # As it is in every formulation: it has no states, and equalities no well-posed one-sided
        # form.
        second = BoxFormulation(builder.allocation.make_qp_of_zero_demand())
        setup.allocating = build_solver(
            workspace.open_again_with_equal_settings(), second, log.allocation, skips=last in twice
        )
        # Failures are counted together, whichever of the two QPs they occur in.
        setup.allocating.details = solver.details
    return setup


def open_backup_workspace(solver: str, step_limit_s: float | None) -> Workspace:
    """Return the workspace of a backup solver, set up anew at each step; InputError without one."""
    try:
        routes = find_solver_record(solver).routes
    except UnknownNameError as error:
        raise UnknownNameError("`backup`", "", error.found, error.allowed) from None
    route: Route = "native" if "native" in routes else "qpsolvers"
    workspace = open_workspace(solver, route=route, step_limit_s=step_limit_s)
    workspace.setup_every_step = True
    return workspace


AnyCase = TypeVar("AnyCase", Scenario, LinearMPC, Case)


def adapt_scenario_to_cell(cell: Cell, scenario: AnyCase) -> AnyCase:
    """Return the scenario, with the unconstrained law as controller where the run requests it."""
    if cell.formulation != "none" or isinstance(scenario, LinearMPC):
        return scenario
    return replace(scenario, controller=scenario.controller.adapt_to_baseline_law())


def build_sequence_solver_and_log(
    sequence: QPSequence,
    workspace: Workspace,
    formulation: Formulation,
    rounds: int,
    new_log: NewLog,
) -> tuple[QPSequence, TimedSolver, RawLog]:
    """Return a replay's QPs in the solver's formulation, the timed solver, and a new raw log."""
    log = new_log(make_replay_layout(rounds + 1, len(sequence), sequence.base.n, sequence.base.m))
    steps, formulated = formulate_sequence(formulation, sequence)
    return steps, TimedSolver(workspace, formulated, clock), log
