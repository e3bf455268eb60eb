"""What runs inside a cell's own process: one solver, pinned to one core, alone with its library.

Every function here is the target of a process forked from a template that has no solver loaded
(`supervise.py`); it leaves its raw log and a small JSON verdict behind and never prints.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.bench.judge.closed_loop import Evaluated, evaluate_log
from dpbench.bench.judge.replay import evaluate_sequence
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.disturbance import counters
from dpbench.bench.record.raw_log import RawLog, loop_layout, replay_layout
from dpbench.bench.run.closed_loop import ClosedLoopSetup, closed_loop
from dpbench.bench.run.exact_loop import ExactLoop, base_problem
from dpbench.bench.run.footprint import MemoryWatch, affordable_steps, measure_steps, threads
from dpbench.bench.run.formulation import in_loop, in_replay
from dpbench.bench.run.qp_builder import QPBuilder
from dpbench.bench.run.replay import PREROLL, ReplayRun
from dpbench.bench.run.slow_computer import delay_of, usage_of_process
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.bench.sequences.source import source_of
from dpbench.bench.workers.notice import AtWork, post
from dpbench.bench.workers.process_setup import pin, settle, verdict_of, write_verdict
from dpbench.errors import CertificateError, InputError
from dpbench.scenario.scenario import scenario_of
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.contract import Workspace
from dpbench.solvers.isolation import isolate
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import load_solver_module

clock = time.perf_counter_ns


@dataclass(frozen=True)
class BatchCell:
    """A cell of a batch: its name and JSON, the file behind its QPs, where its columns go."""

    name: str
    cell: str
    source: Path
    evaluated: Path


def _open(cell: Cell, folder: Path, name: str, *, settled: bool = False) -> Workspace | None:
    """Settle the process and open the cell's solver in it; None leaves a verdict `refused`."""
    if not settled:
        settle(folder / f"{name}.noise")
    post(AtWork.OPENING)
    try:
        if not settled:
            if cell.solver_module:
                load_solver_module(cell.solver_module)
            isolate(cell.solver)
        workspace = open_workspace(
            cell.solver, route=cell.route, policy=cell.policy, settings=cell.settings
        )
    except InputError as error:
        post(AtWork.HARNESS)
        write_verdict(folder / f"{name}.json", verdict_of("refused", str(error)))
        return None
    post(AtWork.HARNESS)
    return workspace


def _worst_detail(timed_solver: TimedSolver) -> str:
    """The most frequent words of the library about its failures, with their count."""
    if not timed_solver.details:
        return ""
    words, count = max(timed_solver.details.items(), key=lambda item: item[1])
    return f"{count} × {words}"


def run_closed_loop_cell(text: str, folder: Path, name: str, core: int) -> None:
    """Run a closed-loop cell; raw log and verdict appear in `folder` under `name`."""
    cell = Cell.from_json(text)
    verdict_path = folder / f"{name}.json"
    pin(core)
    workspace = _open(cell, folder, name)
    if workspace is None:
        return
    scenario = scenario_of(cell.scenario).first(cell.steps)
    builder = QPBuilder(scenario, cell.units, sparse=cell.formulation == "sparse")
    log = RawLog.create(folder / f"{name}.raw", loop_layout(scenario.steps, *builder.sizes))
    formulated = in_loop(cell.formulation, builder, base_problem(builder.condensed))
    timed_solver = TimedSolver(workspace, formulated, clock)
    limit_ns, delay = round(cell.limit_s * 1e9), delay_of(cell, scenario.sample_s)
    setup = ClosedLoopSetup(
        scenario,
        builder,
        timed_solver,
        log,
        cell.fallback,
        limit_ns,
        clock,
        delay,
        usage_of_process,
    )
    before = counters()
    post(AtWork.SOLVER)
    complete = closed_loop(setup)
    post(AtWork.HARNESS)
    np.subtract(counters(), before, out=log.counters[0])
    detail = _worst_detail(timed_solver)
    if not complete:
        stop = f"stopped after {cell.limit_s:g} s with {int(log.done[0])} steps"
        detail = f"{stop}; {detail}" if detail else stop
    ended = "finished" if complete else "timed_out"
    write_verdict(verdict_path, verdict_of(ended, detail, workspace.form, timed_solver.size))


def run_replay_cell(
    text: str, folder: Path, name: str, core: int, source: Path, orders: Connection
) -> None:
    """Serve replay rounds: receive a round number, replay it, send whether it was completed.

    None ends the service. The QPs come from the file `source` that `make_source` left.
    """
    cell, memory = Cell.from_json(text), MemoryWatch()
    workspace = _open(cell, folder, name)
    if workspace is None:
        orders.send(None)
        return
    memory.opened()
    configuration, timed_solver, log = _replay_run(
        cell, workspace, folder / f"{name}.raw", source, memory=memory
    )
    # Pinned only now, so that several workers can import their libraries side by side.
    pin(core)
    orders.send(True)
    complete = True
    while (r := orders.recv()) is not None:
        complete = configuration.round(r)
        orders.send(complete)
    post(AtWork.HARNESS)
    log.footprint[:3] = (memory.peak_bytes(), *threads())
    write_verdict(
        folder / f"{name}.json", _replay_verdict(cell, workspace, timed_solver, log, complete)
    )
    # The verdict stands: what happens from here on is no part of the replay.
    if complete:
        log.footprint[3:] = measure_steps(
            configuration.sequence, timed_solver, affordable_steps(log)
        )


def _replay_run(
    cell: Cell,
    workspace: Workspace,
    raw: Path,
    source: Path,
    *,
    preroll: int = PREROLL,
    memory: MemoryWatch | None = None,
) -> tuple[ReplayRun, TimedSolver, RawLog]:
    sequence = source_of(cell).load(cell, source).sequence
    layout = replay_layout(cell.rounds + 1, len(sequence), sequence.base.n, sequence.base.m)
    log = RawLog.create(raw, layout)
    steps, formulated = in_replay(cell.formulation, sequence)
    timed_solver = TimedSolver(workspace, formulated, clock)
    if memory is not None:
        memory.loaded(log)
    post(AtWork.SOLVER)
    configuration = ReplayRun(
        steps,
        timed_solver,
        log,
        warmup_steps=cell.warmup_steps,
        limit_ns=round(cell.limit_s * 1e9),
        clock=clock,
        preroll=preroll,
    )
    return configuration, timed_solver, log


def _replay_verdict(
    cell: Cell, workspace: Workspace, timed_solver: TimedSolver, log: RawLog, complete: bool
) -> dict[str, Any]:
    detail = _worst_detail(timed_solver)
    if not complete:
        stop = f"stopped after {cell.limit_s:g} s in round {int((log.done > 0).sum()) - 1}"
        detail = f"{stop}; {detail}" if detail else stop
    ended = "finished" if complete else "timed_out"
    return verdict_of(ended, detail, workspace.form, timed_solver.size)


def run_replay_batch(cells: Sequence[BatchCell], folder: Path, core: int) -> None:
    """Replay the cells of one configuration, each with a raw log and a verdict of its own."""
    pin(core)
    for i, batch_cell in enumerate(cells):
        post(AtWork.HARNESS, i)
        cell = Cell.from_json(batch_cell.cell)
        workspace = _open(cell, folder, batch_cell.name, settled=i > 0)
        if workspace is None:
            continue
        raw = folder / f"{batch_cell.name}.raw"
        # Without a time to take, cold caches do no harm, and a step that hangs should be recorded.
        configuration, timed_solver, log = _replay_run(
            cell, workspace, raw, batch_cell.source, preroll=0
        )
        complete = all(configuration.round(r) for r in range(cell.rounds + 1))
        post(AtWork.HARNESS)
        verdict = _replay_verdict(cell, workspace, timed_solver, log, complete)
        write_verdict(folder / f"{batch_cell.name}.json", verdict)
        # The collector is off while a solver works.
        del workspace, configuration, timed_solver, log
        gc.collect()


def make_source(text: str, folder: Path, name: str, core: int, path: Path) -> None:
    """Make the file behind a cell's QPs at `path` (.npz); a verdict appears in `folder`."""
    pin(core)
    settle(folder / f"{name}.noise")
    part = path.with_suffix(".part.npz")
    try:
        source_of(Cell.from_json(text)).make(part)
        part.replace(path)
    except (CertificateError, InputError) as error:
        write_verdict(folder / f"{name}.json", verdict_of("invalid", str(error)))
        return
    finally:
        part.unlink(missing_ok=True)
    write_verdict(folder / f"{name}.json", verdict_of("finished", ""))


def evaluate_cell(
    text: str, folder: Path, name: str, core: int, source: Path, evaluated: Path
) -> None:
    """Let the referee judge the raw log of a cell; the columns appear in `evaluated` (.npz).

    Runs in a process of its own, in which the solver under test was never loaded.
    """
    evaluate_batch([BatchCell(name, text, source, evaluated)], folder, core)


def evaluate_batch(cells: Sequence[BatchCell], folder: Path, core: int) -> None:
    """As `evaluate_cell`, for several cells one after the other."""
    pin(core)
    settle(folder / f"{cells[0].name}.noise")
    for i, batch_cell in enumerate(cells):
        post(AtWork.HARNESS, i)
        log = RawLog.open(folder / f"{batch_cell.name}.raw")
        _evaluate(batch_cell, log).save(batch_cell.evaluated)
        write_verdict(folder / f"{batch_cell.name}.evaluated.json", verdict_of("finished", ""))


def _evaluate(batch_cell: BatchCell, log: RawLog) -> Evaluated:
    cell = Cell.from_json(batch_cell.cell)
    if cell.mode == "replay":
        found = source_of(cell).load(cell, batch_cell.source)
        judged = cell.solver not in CALIBRATION
        return evaluate_sequence(log, found.sequence, found.sample_s, found.optima, judged=judged)
    return evaluate_log(cell, log, ExactLoop.load(batch_cell.source))
