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

from dpbench.bench.judge.closed_loop import Graded, grade_log
from dpbench.bench.judge.replay import grade_sequence
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.disturbance import counters
from dpbench.bench.record.raw_log import RawLog, loop_layout, replay_layout
from dpbench.bench.run.closed_loop import Voyage, closed_loop
from dpbench.bench.run.exact_loop import ExactLoop, base_problem
from dpbench.bench.run.footprint import MemoryWatch, affordable_steps, measure_steps, threads
from dpbench.bench.run.formulation import in_loop, in_replay
from dpbench.bench.run.qp_builder import Emitter
from dpbench.bench.run.replay import PREROLL, ReplayArm
from dpbench.bench.run.slow_computer import pace_of, usage_of_process
from dpbench.bench.run.timed_solver import SolverPort
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
class Link:
    """A cell of a chain: its name and JSON, the file behind its QPs, where its columns go."""

    name: str
    cell: str
    source: Path
    graded: Path


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


def _worst_detail(port: SolverPort) -> str:
    """The most frequent words of the library about its failures, with their count."""
    if not port.details:
        return ""
    words, count = max(port.details.items(), key=lambda item: item[1])
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
    emitter = Emitter(scenario, cell.units, sparse=cell.formulation == "sparse")
    log = RawLog.create(folder / f"{name}.raw", loop_layout(scenario.steps, *emitter.sizes))
    formulated = in_loop(cell.formulation, emitter, base_problem(emitter.builder))
    port = SolverPort(workspace, formulated, clock)
    limit_ns, pace = round(cell.limit_s * 1e9), pace_of(cell, scenario.sample_s)
    voyage = Voyage(
        scenario, emitter, port, log, cell.fallback, limit_ns, clock, pace, usage_of_process
    )
    before = counters()
    post(AtWork.SOLVER)
    complete = closed_loop(voyage)
    post(AtWork.HARNESS)
    np.subtract(counters(), before, out=log.counters[0])
    detail = _worst_detail(port)
    if not complete:
        stop = f"stopped after {cell.limit_s:g} s with {int(log.done[0])} steps"
        detail = f"{stop}; {detail}" if detail else stop
    ended = "finished" if complete else "timed_out"
    write_verdict(verdict_path, verdict_of(ended, detail, workspace.form, port.size))


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
    arm, port, log = _replay_arm(cell, workspace, folder / f"{name}.raw", source, memory=memory)
    # Pinned only now, so that several workers can import their libraries side by side.
    pin(core)
    orders.send(True)
    complete = True
    while (r := orders.recv()) is not None:
        complete = arm.round(r)
        orders.send(complete)
    post(AtWork.HARNESS)
    log.footprint[:3] = (memory.peak_bytes(), *threads())
    write_verdict(folder / f"{name}.json", _replay_verdict(cell, workspace, port, log, complete))
    # The verdict stands: what happens from here on is no part of the replay.
    if complete:
        log.footprint[3:] = measure_steps(arm.sequence, port, affordable_steps(log))


def _replay_arm(
    cell: Cell,
    workspace: Workspace,
    raw: Path,
    source: Path,
    *,
    preroll: int = PREROLL,
    memory: MemoryWatch | None = None,
) -> tuple[ReplayArm, SolverPort, RawLog]:
    sequence = source_of(cell).load(cell, source).sequence
    layout = replay_layout(cell.rounds + 1, len(sequence), sequence.base.n, sequence.base.m)
    log = RawLog.create(raw, layout)
    steps, formulated = in_replay(cell.formulation, sequence)
    port = SolverPort(workspace, formulated, clock)
    if memory is not None:
        memory.loaded(log)
    post(AtWork.SOLVER)
    arm = ReplayArm(
        steps,
        port,
        log,
        warmup_steps=cell.warmup_steps,
        limit_ns=round(cell.limit_s * 1e9),
        clock=clock,
        preroll=preroll,
    )
    return arm, port, log


def _replay_verdict(
    cell: Cell, workspace: Workspace, port: SolverPort, log: RawLog, complete: bool
) -> dict[str, Any]:
    detail = _worst_detail(port)
    if not complete:
        stop = f"stopped after {cell.limit_s:g} s in round {int((log.done > 0).sum()) - 1}"
        detail = f"{stop}; {detail}" if detail else stop
    ended = "finished" if complete else "timed_out"
    return verdict_of(ended, detail, workspace.form, port.size)


def run_replay_chain(links: Sequence[Link], folder: Path, core: int) -> None:
    """Replay the cells of one arm, each with a raw log and a verdict of its own."""
    pin(core)
    for i, link in enumerate(links):
        post(AtWork.HARNESS, i)
        cell = Cell.from_json(link.cell)
        workspace = _open(cell, folder, link.name, settled=i > 0)
        if workspace is None:
            continue
        raw = folder / f"{link.name}.raw"
        # Without a time to take, cold caches do no harm, and a step that hangs should be recorded.
        arm, port, log = _replay_arm(cell, workspace, raw, link.source, preroll=0)
        complete = all(arm.round(r) for r in range(cell.rounds + 1))
        post(AtWork.HARNESS)
        verdict = _replay_verdict(cell, workspace, port, log, complete)
        write_verdict(folder / f"{link.name}.json", verdict)
        # The collector is off while a solver works.
        del workspace, arm, port, log
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


def grade_cell(text: str, folder: Path, name: str, core: int, source: Path, graded: Path) -> None:
    """Let the referee judge the raw log of a cell; the columns appear in `graded` (.npz).

    Runs in a process of its own, in which the solver under test was never loaded.
    """
    grade_chain([Link(name, text, source, graded)], folder, core)


def grade_chain(links: Sequence[Link], folder: Path, core: int) -> None:
    """As `grade_cell`, for several cells one after the other."""
    pin(core)
    settle(folder / f"{links[0].name}.noise")
    for i, link in enumerate(links):
        post(AtWork.HARNESS, i)
        log, began = RawLog.open(folder / f"{link.name}.raw"), clock()
        graded = _grade(link, log)
        graded.columns["referee_ns"] = np.array([clock() - began])
        graded.save(link.graded)
        write_verdict(folder / f"{link.name}.graded.json", verdict_of("finished", ""))


def _grade(link: Link, log: RawLog) -> Graded:
    cell = Cell.from_json(link.cell)
    if cell.mode == "replay":
        found = source_of(cell).load(cell, link.source)
        judged = cell.solver not in CALIBRATION
        return grade_sequence(log, found.sequence, found.sample_s, found.optima, judged=judged)
    return grade_log(cell, log, ExactLoop.load(link.source))
