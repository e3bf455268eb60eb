"""What runs inside a cell's own process: one solver, pinned to one core, alone with its library.

Every function here is the target of a process forked from a template that has no solver loaded
(`supervise.py`); it leaves its raw log and a small JSON verdict behind and never prints.
"""

from __future__ import annotations

import gc
import json
import os
import time
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from dpbench.bench.cell import Cell
from dpbench.bench.emitter import Emitter
from dpbench.bench.exact import ExactLoop, base_problem, sequence_of, solve_exactly
from dpbench.bench.grade import grade_log
from dpbench.bench.loop import Voyage, closed_loop
from dpbench.bench.port import SolverPort
from dpbench.bench.rawlog import RawLog, loop_layout, replay_layout
from dpbench.bench.replay import ReplayArm
from dpbench.errors import CertificateError, InputError
from dpbench.scenario import scenario_of
from dpbench.solvers.contract import Workspace
from dpbench.solvers.isolation import isolate
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import load_solver_module

clock = time.perf_counter_ns


def _settle(noise: Path) -> None:
    """Send what libraries print to a file, ignore warnings and stop the garbage collector."""
    sink = os.open(noise, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    warnings.simplefilter("ignore")
    gc.collect()
    gc.freeze()
    gc.disable()


def _pin(core: int) -> None:
    """Stay on one core from now on."""
    os.sched_setaffinity(0, {core})


def _write(path: Path, verdict: dict[str, Any]) -> None:
    """Leave a JSON verdict at `path`, whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(verdict), encoding="utf-8")
    part.replace(path)


def _verdict(outcome: str, detail: str, form: str = "") -> dict[str, Any]:
    return {"outcome": outcome, "detail": detail, "form": form}


def _open(cell: Cell, folder: Path, name: str) -> Workspace | None:
    """Settle the process and open the cell's solver in it; None leaves a verdict `refused`."""
    _settle(folder / f"{name}.noise")
    try:
        if cell.solver_module:
            load_solver_module(cell.solver_module)
        isolate(cell.solver)
        return open_workspace(
            cell.solver, route=cell.route, policy=cell.policy, settings=cell.settings
        )
    except InputError as error:
        _write(folder / f"{name}.json", _verdict("refused", str(error)))
        return None


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
    _pin(core)
    workspace = _open(cell, folder, name)
    if workspace is None:
        return
    scenario = scenario_of(cell.scenario).first(cell.steps)
    emitter = Emitter(scenario, cell.units)
    log = RawLog.create(folder / f"{name}.raw", loop_layout(scenario.steps, *emitter.sizes))
    port = SolverPort(workspace, cell.formulation, base_problem(emitter.builder), clock)
    limit_ns = round(cell.limit_s * 1e9)
    complete = closed_loop(Voyage(scenario, emitter, port, log, cell.fallback, limit_ns, clock))
    detail = _worst_detail(port)
    if not complete:
        stop = f"stopped after {cell.limit_s:g} s with {int(log.done[0])} steps"
        detail = f"{stop}; {detail}" if detail else stop
    _write(verdict_path, _verdict("finished" if complete else "timed_out", detail, workspace.form))


def run_replay_cell(
    text: str, folder: Path, name: str, core: int, exact_path: Path, orders: Connection
) -> None:
    """Serve replay rounds: receive a round number, replay it, send whether it was completed.

    None ends the service. The QPs are made from the exactly solved loop at `exact_path`.
    """
    cell = Cell.from_json(text)
    verdict_path = folder / f"{name}.json"
    workspace = _open(cell, folder, name)
    if workspace is None:
        orders.send(None)
        return
    scenario = scenario_of(cell.scenario)
    exact = ExactLoop.load(exact_path)
    sequence = sequence_of(scenario, exact, units=cell.units, first=cell.first, count=cell.steps)
    layout = replay_layout(cell.rounds + 1, len(sequence), sequence.base.n, sequence.base.m)
    log = RawLog.create(folder / f"{name}.raw", layout)
    port = SolverPort(workspace, cell.formulation, sequence.base, clock)
    arm = ReplayArm(
        sequence,
        port,
        log,
        warmup_steps=cell.warmup_steps,
        limit_ns=round(cell.limit_s * 1e9),
        clock=clock,
    )
    # Pinned only now, so that several workers can import their libraries side by side.
    _pin(core)
    orders.send(True)
    complete = True
    while (r := orders.recv()) is not None:
        complete = arm.round(r)
        orders.send(complete)
    detail = _worst_detail(port)
    if not complete:
        stop = f"stopped after {cell.limit_s:g} s in round {int((log.done > 0).sum()) - 1}"
        detail = f"{stop}; {detail}" if detail else stop
    _write(verdict_path, _verdict("finished" if complete else "timed_out", detail, workspace.form))


def run_exact_loop(text: str, folder: Path, name: str, core: int) -> None:
    """Solve the scenario of a cell exactly; `name`.npz and a verdict appear in `folder`."""
    _pin(core)
    _settle(folder / f"{name}.noise")
    try:
        exact = solve_exactly(scenario_of(Cell.from_json(text).scenario))
    except CertificateError as error:
        _write(folder / f"{name}.json", _verdict("invalid", str(error)))
        return
    exact.save(folder / f"{name}.npz")
    _write(folder / f"{name}.json", _verdict("finished", ""))


def grade_cell(
    text: str, folder: Path, name: str, core: int, exact_path: Path, graded: Path
) -> None:
    """Let the referee judge the raw log of a cell; the columns appear in `graded` (.npz).

    Runs in a process of its own, in which the solver under test was never loaded.
    """
    _pin(core)
    _settle(folder / f"{name}.noise")
    log = RawLog.open(folder / f"{name}.raw")
    grade_log(Cell.from_json(text), log, ExactLoop.load(exact_path)).save(graded)
    _write(folder / f"{name}.graded.json", _verdict("finished", ""))
