"""Run one solver in this process: the library's door for a notebook or a test.

A campaign runs cells in processes of their own; here nothing protects the caller from a solver
that crashes, and no core is pinned. The assessment is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from dpbench.bench.judge.closed_loop import Evaluated, evaluate_log
from dpbench.bench.judge.replay import evaluate_sequence
from dpbench.bench.judge.rows import run_row, step_rows
from dpbench.bench.record.cell import FALLBACKS, FORMULATIONS, Cell, Fallback, Formulation, Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.record.schema import as_runs, as_steps
from dpbench.bench.run.assemble import NO_LIMIT_NS, clock, closed_loop_setup, replay_parts
from dpbench.bench.run.closed_loop import closed_loop
from dpbench.bench.run.exact_loop import solve_exactly
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.qp.program import QPSequence
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Workspace
from dpbench.solvers.table import Availability


@dataclass(frozen=True, eq=False)
class Run:
    """A judged run: `steps` with the columns of steps.parquet, `summary` with those of runs."""

    steps: pd.DataFrame
    summary: pd.Series[Any]


def run_closed_loop(
    scenario: Scenario,
    workspace: Workspace,
    *,
    units: UnitSystem = "scaled",
    formulation: Formulation = "condensed_box",
    fallback: Fallback = "shifted_plan",
    slowdown: float = 0.0,
    deadline_s: float = 0.0,
) -> Run:
    """Let `workspace` steer the ship through `scenario`, and judge every answer.

    Parameters
    ----------
    slowdown : how much slower than this machine the ship's computer is (≥ 1), so that answers
        arrive late; 0 for a ship that waits for each. Time is simulated, not waited for.
    deadline_s : what a step may take of its time [s], at most the sample; 0 for the sample.

    Raises
    ------
    InputError : for an unknown formulation or fallback, "sparse" for a scenario that has none, or
        a slow-down or deadline that cannot be.
    """
    _check("fallback", fallback, FALLBACKS)
    _check_workspace(workspace, formulation)
    cell = _cell_of(
        workspace,
        mode="closed_loop",
        scenario=scenario.files,
        steps=scenario.steps,
        formulation=formulation,
        units=units,
        fallback=fallback,
        slowdown=slowdown,
        deadline_s=deadline_s,
    )
    setup = closed_loop_setup(cell, scenario, workspace, RawLog.in_memory, NO_LIMIT_NS)
    closed_loop(setup)
    evaluated = evaluate_log(cell, setup.log, solve_exactly(scenario))
    return _run(cell, workspace, setup.solver, evaluated)


def replay(
    sequence: QPSequence,
    workspace: Workspace,
    *,
    repeats: int = 5,
    warmup_steps: int = 50,
    formulation: Formulation = "condensed_box",
) -> Run:
    """Replay `sequence` through `workspace`: a warm-up, then `repeats` rounds, all judged.

    Raises
    ------
    InputError : for an unknown formulation, or "sparse" for QPs without a scenario behind them.
    """
    _check_workspace(workspace, formulation)
    if repeats < 1:
        raise InputError("replay", "repeats", repeats, "1 or more")
    warmup_steps = min(warmup_steps, len(sequence))
    steps, solver, log = replay_parts(sequence, workspace, formulation, repeats, RawLog.in_memory)
    run = ReplayRun(
        steps, solver, log, warmup_steps=warmup_steps, limit_ns=NO_LIMIT_NS, clock=clock
    )
    for r in range(repeats + 1):
        run.round(r)
    cell = _cell_of(
        workspace,
        mode="replay",
        scenario={"name": sequence.name},
        steps=len(sequence),
        formulation=formulation,
        units="scaled" if sequence.units is None else "si",
        rounds=repeats,
        warmup_steps=warmup_steps,
    )
    sample_s = float(sequence.meta.get("sample_s", float("nan")))
    return _run(cell, workspace, solver, evaluate_sequence(log, sequence, sample_s))


def _check(key: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise InputError("run", key, repr(value), f"one of {', '.join(allowed)}")


def _check_workspace(workspace: object, formulation: str) -> None:
    _check("formulation", formulation, FORMULATIONS)
    if not isinstance(workspace, Workspace):
        raise InputError("run", "workspace", repr(workspace), "a Workspace; see open_workspace")


def _cell_of(workspace: Workspace, **fields: Any) -> Cell:
    """The cell of a run of a workspace, whose settings have no name."""
    return Cell(
        solver=workspace.solver,
        route=workspace.route,
        policy=workspace.policy,
        settings="",
        **fields,
    )


def _run(cell: Cell, workspace: Workspace, timed_solver: TimedSolver, evaluated: Evaluated) -> Run:
    steps = step_rows("in-process", cell, evaluated)
    outcome = Outcome("finished", "", workspace.form, *timed_solver.size)
    row = run_row("in-process", cell, outcome, Availability(True), "", evaluated, steps)
    return Run(as_steps(steps), as_runs(pd.DataFrame([row])).iloc[0])
