"""Targets of the processes of one configuration: one solver, pinned to one core.

Each runs in a process forked from a template without solvers (`child.py`), leaves its raw log and a
small JSON verdict, and never prints.
"""

import gc
import math
import os
import time
import warnings
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pyarrow as pa

from dpbench.bench.judge.evaluation import EvaluatedCell, evaluate_loop_log, evaluate_replay_log
from dpbench.bench.judge.rows import make_run_row, make_step_columns
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.disturbance import read_disturbance_counters
from dpbench.bench.record.npz import open_arrays
from dpbench.bench.record.raw_log import Layout, RawLog
from dpbench.bench.record.result_folder import write_json
from dpbench.bench.record.step_table import Row, make_batch_part, make_step_record_batch
from dpbench.bench.run.assemble import build_closed_loop_setup, build_sequence_solver_and_log, clock
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.bench.run.exact_loop import ExactLoop, StepReport, parse_stored_weather
from dpbench.bench.run.footprint import (
    MEMORY_SHARE,
    MemoryWatch,
    count_affordable_steps,
    count_own_and_library_threads,
    limit_further_memory,
    machine_memory_bytes,
    measure_step_memory,
    process_peak_bytes,
    reset_peak_memory,
)
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.replay import PREROLL, ReplayRun
from dpbench.bench.run.timed_solver import (
    MOST_HANGS,
    STEP_SHARE,
    TimedSolver,
    list_failure_descriptions,
    raise_at_step_limit,
)
from dpbench.bench.sequences.source import ReplayInput, choose_source_file, is_readable, read_replay
from dpbench.bench.workers.orphans import has_children
from dpbench.bench.workers.plant_watch import PlantWatch
from dpbench.bench.workers.shared_status import (
    Phase,
    describe_truncated_output,
    discard_captured_output,
    set_phase,
    set_step,
)
from dpbench.errors import CertificateError, InputError
from dpbench.scenario.plants.contract import PlantError
from dpbench.scenario.scenario import build_or_reuse_scenario
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.contract import Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import (
    Availability,
    block_imports_of_other_solvers,
    load_plugin_solver_from_file,
)

QUICK_S = 3.0
"""Time from which the steps of a reference loop are shown while it is made [s]."""
Hang = tuple[int, int]  # Round, 0 in a closed loop, and step in which a process hung


def disable_gc_and_warnings() -> None:
    """Switch off the garbage collector and warnings in this process."""
    warnings.simplefilter("ignore")
    gc.collect()
    gc.freeze()
    gc.disable()


def pin_to_core(core: int) -> None:
    """Bind this process to one core."""
    os.sched_setaffinity(0, {core})


def write_outcome(path: Path, outcome: Outcome) -> None:
    """Write the outcome of a run or file to a JSON file, for the supervisor."""
    write_json(path, vars(outcome))


@dataclass(frozen=True)
class BatchCell:
    """One run of a batch, with all that a worker process needs to do and judge it.

    outcome : once it ran; library, machine_id, concurrency, campaign_utc, turns : for its row.
    hung : where earlier processes of it hung; its log is theirs.
    module : path of its plug-in on this machine; "" for none.
    """

    name: str
    cell: str
    limit_s: float
    source: Path
    outcome: Outcome | None
    library: Availability
    machine_id: str
    module: str = ""
    concurrency: int | None = None
    campaign_utc: str = ""
    turns: str = ""
    hung: tuple[Hang, ...] = ()


def find_hang(cell: Cell, raw: Path, before: Sequence[Hang]) -> Hang | None:
    """Return round and step in which a killed process hung; None where it cannot be continued.

    It cannot where it hung too often, or outside of its steps. The log is marked as not started, so
    that the next process has time to open its library.
    """
    if len(before) >= MOST_HANGS:
        return None
    try:
        log = RawLog.open(raw)
    except (OSError, ValueError):
        return None
    if not log.started[0]:
        return None
    hang = _find_open_step(cell, log, {k for _, k in before})
    if hang is not None:
        log.started[0] = 0
    return hang


def _find_open_step(cell: Cell, log: RawLog, known: Set[int]) -> Hang | None:
    """Return the first unfinished round and step of a run, by its log, except `known` steps."""
    if cell.mode == "closed_loop":
        return (0, int(log.done[0])) if log.done[0] < cell.steps else None
    planned = np.full(len(log.done), cell.steps)
    planned[0] = cell.warmup_steps
    open_rounds = np.flatnonzero((log.done < planned) & (log.attempts > 0))
    if not len(open_rounds):
        return None
    r = int(open_rounds[-1])
    # Before its round a process solves the first steps without a record.
    done = int(log.done[r])
    first = int(np.argmax(log.first_ns == 0)) if r == 0 and not done else done
    return r, next(k for k in range(first, cell.steps + 1) if k not in known)


def _open_workspace(cell: Cell, *, settled: bool = False) -> Workspace:
    """Load the run's solver in this process and return its workspace, memory limited."""
    if settled:
        discard_captured_output()
        reset_peak_memory()
    else:
        disable_gc_and_warnings()
    set_phase(Phase.OPENING)
    if not settled:
        limit_further_memory(
            round(cell.memory_gb * 1e9) or round(MEMORY_SHARE * machine_memory_bytes())
        )
        if cell.solver_module:
            load_plugin_solver_from_file(cell.solver_module, tried=True)
        block_imports_of_other_solvers(cell.solver, *filter(None, [cell.backup]))
    workspace = open_workspace(
        cell.solver,
        route=cell.route,
        policy=cell.policy,
        settings=cell.solver_settings,
        step_limit_s=STEP_SHARE * cell.limit_s,
    )
    set_phase(Phase.HARNESS)
    return workspace


def _open_or_refuse(
    cell: Cell, folder: Path, name: str, *, settled: bool = False
) -> Workspace | None:
    """Return the run's solver workspace; None, and outcome "refused", where it cannot be opened."""
    try:
        return _open_workspace(cell, settled=settled)
    except InputError as error:
        set_phase(Phase.HARNESS)
        write_outcome(folder / f"{name}.json", Outcome("refused", str(error)))
        return None


def run_batch(cells: Sequence[BatchCell], folder: Path, core: int) -> None:
    """Do runs of one solver configuration in turn; each leaves a raw log and an outcome file."""
    pin_to_core(core)
    for i, batch_cell in enumerate(cells):
        set_phase(Phase.HARNESS, i)
        name = batch_cell.name
        cell = replace(Cell.from_json(batch_cell.cell), solver_module=batch_cell.module)
        workspace = _open_or_refuse(cell, folder, name, settled=i > 0)
        if workspace is None:
            continue
        raw = folder / f"{name}.raw"
        if cell.mode == "closed_loop":
            verdict = _run_closed_loop(cell, workspace, raw, batch_cell.source, batch_cell.hung)
        else:
            verdict = _replay_untimed(cell, workspace, raw, batch_cell.source, batch_cell.hung)
        write_outcome(folder / f"{name}.json", verdict)
        # The collector is off while a solver works.
        del workspace
        gc.collect()
        # What a cell started ends with it: the supervisor ends that of a process that ended.
        if has_children():
            return


def _make_log_opener(raw: Path, hung: Sequence[Hang]) -> Callable[[Layout], RawLog]:
    """Return a function that creates a run's raw log, or opens that of a hung process."""
    return (lambda layout: RawLog.open(raw)) if hung else partial(RawLog.create, raw)


def _run_closed_loop(
    cell: Cell, workspace: Workspace, raw: Path, source: Path, hung: Sequence[Hang]
) -> Outcome:
    """Run a cell's closed loop to its end or a limit; return its outcome."""
    scenario = build_or_reuse_scenario(cell.scenario).truncate(cell.steps)
    limit_ns, new_log = round(cell.limit_s * 1e9), _make_log_opener(raw, hung)
    try:
        setup = build_closed_loop_setup(
            cell, scenario, workspace, new_log, limit_ns, hung=[k for _, k in hung]
        )
    except InputError as error:
        return Outcome("refused", str(error))
    with open_arrays(source) as stored:
        setup.drawn = parse_stored_weather(stored)
    before, watch = read_disturbance_counters(), PlantWatch(Phase.SOLVER, cell.fmu_name)
    set_phase(Phase.SOLVER)
    try:
        with watch.observe(), raise_at_step_limit(STEP_SHARE * cell.limit_s, clock):
            complete = record_closed_loop(setup)
    except PlantError as error:
        set_phase(Phase.HARNESS)
        return Outcome("invalid", str(error))
    # Not where a solver ends the process: that is charged to it by the phase.
    set_phase(Phase.HARNESS)
    if not complete and watch.spent_ns > 0.5 * limit_ns:
        found = f"{watch.spent_ns * 1e-9:.3g} s of the {cell.limit_s:g} s of the run (cell_limit_s)"
        return Outcome("invalid", f"plant {cell.fmu_name} took {found}, and stopped it")
    np.subtract(read_disturbance_counters(), before, out=setup.log.counters[0])
    stopped = "" if complete else f"with {int(setup.log.done[0])} steps"
    return _make_outcome(cell, workspace, setup.solver, stopped)


def _replay_untimed(
    cell: Cell, workspace: Workspace, raw: Path, source: Path, hung: Sequence[Hang]
) -> Outcome:
    """Replay a sequence to check answers alone, without timing; return the outcome."""
    given = choose_source_file(cell).load_replay_input(source)
    # Without a time to take, cold caches do no harm, and a step that hangs should be recorded.
    configuration, timed_solver, log = _prepare_replay(
        cell, workspace, raw, given, preroll=0, hung=hung
    )
    begin = hung[-1][0] if hung else 0
    with raise_at_step_limit(STEP_SHARE * cell.limit_s, clock):
        complete = all(configuration.run_round(r) for r in range(begin, cell.rounds + 1))
    set_phase(Phase.HARNESS)
    return _make_outcome(
        cell, workspace, timed_solver, "" if complete else _describe_last_round(log)
    )


def _describe_last_round(log: RawLog) -> str:
    """Return in words the last round that a stopped replay reached, by its raw log."""
    return f"in round {int(np.flatnonzero(log.done)[-1])}"


def _make_outcome(
    cell: Cell, workspace: Workspace, timed_solver: TimedSolver, stopped: str
) -> Outcome:
    """Return the outcome of a run that ended by itself; `stopped` is a note on its time limit."""
    details = [f"stopped after {cell.limit_s:g} s (cell_limit_s) {stopped}"] if stopped else []
    details += list_failure_descriptions(timed_solver.details)
    detail = "; ".join(filter(None, [*details, describe_truncated_output()]))
    outcome = "timed_out" if stopped else "finished"
    return Outcome(outcome, detail, workspace.form, *timed_solver.size, process_peak_bytes())


@dataclass(frozen=True)
class ReplayOrder:
    """An order to a worker to do one replay: its description, file of QPs, folder and name."""

    cell: str
    source: Path
    folder: Path
    name: str
    hung: tuple[Hang, ...] = ()


def serve_replays(core: int, orders: Connection) -> None:
    """Do replays with one solver configuration in turn, one round per order from a pipe.

    An order is a `ReplayOrder`, then round numbers until None ends the replay. The replies are True
    when it is ready, whether each round was completed, and True when its verdict is written; None
    and no more where the configuration is refused, no reply to None where the replay leaves
    processes behind. None in place of a replay ends the service.
    """
    memory, anywhere, settled = MemoryWatch(), os.sched_getaffinity(0), False
    while (order := orders.recv()) is not None:
        os.sched_setaffinity(0, anywhere)
        if settled:
            memory.begin_replay()
        if not _serve_replay(order, core, orders, memory, settled=settled):
            orders.send(None)
            return
        settled = True
        # The collector is off while a solver works.
        gc.collect()
        if has_children():
            return
        orders.send(True)


def _serve_replay(
    order: ReplayOrder, core: int, orders: Connection, memory: MemoryWatch, *, settled: bool
) -> bool:
    """Do one replay's rounds on order and write its outcome; return False where refused."""
    cell, folder, name = Cell.from_json(order.cell), order.folder, order.name
    workspace = _open_or_refuse(cell, folder, name, settled=settled)
    if workspace is None:
        return False
    memory.record_memory_after_setup()
    given = choose_source_file(cell).load_replay_input(order.source)
    configuration, timed_solver, log = _prepare_replay(
        cell, workspace, folder / f"{name}.raw", given, memory=memory, hung=order.hung
    )
    # Pinned only now, so that several workers can import their libraries side by side.
    pin_to_core(core)
    orders.send(True)
    complete = True
    while (r := orders.recv()) is not None:
        with raise_at_step_limit(STEP_SHARE * cell.limit_s, clock):
            complete = configuration.run_round(r)
        orders.send(complete)
    set_phase(Phase.HARNESS)
    log.footprint[:3] = (memory.peak_bytes(), *count_own_and_library_threads())
    verdict = _make_outcome(
        cell, workspace, timed_solver, "" if complete else _describe_last_round(log)
    )
    write_outcome(folder / f"{name}.json", verdict)
    # The verdict stands unless the solver ends the process: how long this takes is no part of the
    # replay. It takes as long as four rounds, and shows the same in every replay of a process.
    if complete and not (settled or cell.is_hardest_window):
        steps = count_affordable_steps(log)
        set_phase(Phase.SOLVER)
        log.footprint[3:] = measure_step_memory(configuration.sequence, timed_solver, steps)
        set_phase(Phase.HARNESS)
    return True


def _prepare_replay(
    cell: Cell,
    workspace: Workspace,
    raw: Path,
    given: ReplayInput,
    *,
    preroll: int = PREROLL,
    memory: MemoryWatch | None = None,
    hung: Sequence[Hang] = (),
) -> tuple[ReplayRun, TimedSolver, RawLog]:
    """Set up a replay; return it ready for its rounds, with its timed solver and raw log."""
    steps, timed_solver, log = build_sequence_solver_and_log(
        given.sequence, workspace, cell.formulation, cell.rounds, _make_log_opener(raw, hung)
    )
    lead = None if given.lead is None else formulate_sequence(cell.formulation, given.lead)[0]
    if memory is not None:
        memory.record_memory_after_loading(log)
    set_phase(Phase.SOLVER)
    configuration = ReplayRun(
        steps,
        timed_solver,
        log,
        warmup_steps=cell.warmup_steps,
        limit_ns=round(cell.limit_s * 1e9),
        clock=clock,
        preroll=preroll,
        hung=hung,
        lead=lead,
    )
    return configuration, timed_solver, log


def answer_sequences(text: str, folder: Path, name: str, orders: Connection) -> None:
    """Replay each sequence of QPs ordered over a pipe, with the solver opened anew each time.

    An order is a sequence and its time limit [s], the reply whether it was completed; None ends the
    service. The first reply is True, or the reason why the configuration cannot run.
    """
    cell = Cell.from_json(text)
    try:
        _open_workspace(cell)
    except InputError as error:
        orders.send(error)
        return
    orders.send(True)
    while (order := orders.recv()) is not None:
        sequence, limit_s = order
        limited = replace(cell, limit_s=limit_s, warmup_steps=min(cell.warmup_steps, len(sequence)))
        workspace = _open_workspace(cell, settled=True)
        given = ReplayInput(sequence, math.nan, None)
        configuration, _, _ = _prepare_replay(limited, workspace, folder / f"{name}.raw", given)
        complete = all(configuration.run_round(r) for r in range(cell.rounds + 1))
        set_phase(Phase.HARNESS)
        orders.send(complete)
        del workspace, configuration
        gc.collect()


def make_source(text: str, folder: Path, name: str, core: int, path: Path) -> None:
    """Make the file of a run's QPs at `path` unless it is readable; write the outcome."""
    pin_to_core(core)
    disable_gc_and_warnings()
    cell, part = Cell.from_json(text), path.with_suffix(".part.npz")
    try:
        if not is_readable(cell, path):
            with PlantWatch(Phase.HARNESS, cell.fmu_name, cell.limit_s).observe():
                choose_source_file(cell, _make_step_report()).make_file(part)
            part.replace(path)
    except (CertificateError, InputError) as error:
        write_outcome(folder / f"{name}.json", Outcome("invalid", str(error)))
        return
    finally:
        part.unlink(missing_ok=True)
    write_outcome(folder / f"{name}.json", Outcome("finished", ""))


def _make_step_report() -> StepReport:
    """Return a function that reports the steps of a file to the supervisor where it takes long."""
    set_step(0, 0)
    shown_from_s = time.monotonic() + QUICK_S

    def report(done: int, steps: int) -> None:
        if time.monotonic() >= shown_from_s:
            set_step(done, steps)

    return report


def evaluate_batch(cells: Sequence[BatchCell], folder: Path, core: int) -> None:
    """Judge raw logs of runs without loading their solver; write results and outcomes to files."""
    pin_to_core(core)
    disable_gc_and_warnings()
    judged: dict[str, tuple[Row, pa.RecordBatch]] = {}
    for i, batch_cell in enumerate(cells):
        set_phase(Phase.HARNESS, i)
        log = RawLog.open(folder / f"{batch_cell.name}.raw")
        judged[batch_cell.name] = _judge_cell(batch_cell, log)
        if i + 1 == len(cells):
            # Before the last verdict, so that a cell is to blame if this ends the process.
            (folder / f"{cells[0].name}.judged").write_bytes(make_batch_part(judged).data)
        write_outcome(folder / f"{batch_cell.name}.evaluated.json", Outcome("finished", ""))


def _judge_cell(batch_cell: BatchCell, log: RawLog) -> tuple[Row, pa.RecordBatch]:
    """Judge a run from its raw log; return its row and its steps for the result tables."""
    cell, outcome = Cell.from_json(batch_cell.cell), batch_cell.outcome
    assert outcome is not None, "it ran"
    evaluated = _evaluate_log(cell, batch_cell.source, log)
    steps = make_step_columns(cell, evaluated)
    about = batch_cell.name, cell, outcome, batch_cell.library, batch_cell.machine_id
    when = {name: getattr(batch_cell, name) for name in ("concurrency", "campaign_utc", "turns")}
    row = make_run_row(*about, evaluated, steps, **when)
    return row, make_step_record_batch(steps)


def _evaluate_log(cell: Cell, source: Path, log: RawLog) -> EvaluatedCell:
    """Evaluate the raw log of a replay or closed loop; return step columns and metrics."""
    if cell.mode == "replay":
        known, judged = read_replay(cell, source), cell.solver not in CALIBRATION
        replayed = evaluate_replay_log(
            log, known.sequence, known.sample_s, known.optima, judged=judged
        )
        return replace(replayed, metrics=replayed.metrics | known.station)
    return evaluate_loop_log(cell, log, _load_exact_loop(source))


@lru_cache(maxsize=1)
def _load_exact_loop(path: Path) -> ExactLoop:
    """Return the reference loop in a file; the latest is kept for the next runs."""
    return ExactLoop.load(path, with_optima=False)
