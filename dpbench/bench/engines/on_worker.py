"""Tasks that a worker of a cluster runs for a campaign of another machine.

Cells run as on the campaign's own machine, in processes of their own (`CellExecutor`); files are in
a scratch folder until a task ends. Arguments and results are bytes. Nothing here needs Dask.
"""

import ctypes
import multiprocessing
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.cell import HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.record.result_folder import MachineDescription
from dpbench.bench.sequences.source import choose_source_file, is_readable
from dpbench.bench.workers.child import start_forkserver
from dpbench.bench.workers.executor import CellExecutor
from dpbench.bench.workers.jobs import Batch, CellBatch, CellJob, FileBatch, Result, Target
from dpbench.bench.workers.scratch import Scratch
from dpbench.errors import CertificateError, DpbenchError, InputError
from dpbench.locks import hold_free_core_lock
from dpbench.solvers.table import find_solver_availability
from dpbench.temporary_folders import make_temporary_folder_for_block


@dataclass(frozen=True)
class WorkerInfo:
    """A cluster worker's dpbench version and machine, and whether it may start processes."""

    harness_version: str
    may_start: bool
    machine: MachineDescription


@dataclass(frozen=True)
class CampaignContext:
    """Texts of plug-ins by the paths in the cells, and receiver of steps, of all cluster tasks."""

    modules: Mapping[str, str] = field(default_factory=dict)
    progress: Progress = field(default_factory=Silent)


@dataclass(frozen=True)
class MadeFile:
    """A file made on a cluster worker: its outcome and its bytes, none where it failed."""

    outcome: Outcome
    data: bytes = b""


@cache
def describe_worker() -> WorkerInfo:
    """Return dpbench version, machine and leave to start processes of the worker it runs on."""
    may_start = not multiprocessing.current_process().daemon
    return WorkerInfo(HARNESS_VERSION, may_start, describe_machine())


class TaskEndedError(DpbenchError):
    """Raised in a cluster task whose worker is being closed."""


_TASKS: set[int] = set()
"""The threads of tasks that run in this process."""
_ENDING = threading.Lock()


@contextmanager
def _register_task_thread() -> Iterator[None]:
    """Register a cluster task's thread in the block, for `interrupt_tasks` to end it."""
    thread = threading.get_ident()
    with _ENDING:
        _TASKS.add(thread)
    try:
        yield
    finally:
        with _ENDING:
            _TASKS.remove(thread)


def interrupt_tasks() -> None:
    """Interrupt all cluster tasks of this process by `TaskEndedError` in their threads."""
    with _ENDING:
        for thread in _TASKS:
            set_error = ctypes.pythonapi.PyThreadState_SetAsyncExc
            set_error(ctypes.c_ulong(thread), ctypes.py_object(TaskEndedError))


@_register_task_thread()
def make_files(
    context: CampaignContext,
    target: Target,
    texts: Mapping[str, str],
    limit_s: float | None,
    *,
    isolated: bool,
) -> dict[str, MadeFile]:
    """Make files on one core of this cluster worker; return each with its outcome, by path."""
    with (
        hold_free_core_lock() as core,
        _open_executor_and_folder(context, [core]) as (executor, folder),
    ):
        paths = {folder / Path(name).name: name for name in texts}
        here = {path: texts[name] for path, name in paths.items()}
        results = _run_batch(executor, FileBatch(target, here, limit_s, isolated=isolated), {})
        made = {}
        for path, outcome in ((Path(result.run_id), result.outcome) for result in results):
            data = path.read_bytes() if outcome.outcome == "finished" else b""
            made[paths[path]] = MadeFile(outcome, data)
        return made


def read_or_make_source(cell: Cell, path: Path) -> MadeFile:
    """Return the file of a run's QPs as bytes, on the campaign's machine; make it if missing."""
    if not is_readable(cell, path):
        try:
            choose_source_file(cell).make_file(path)
        except (CertificateError, InputError) as error:
            return MadeFile(Outcome("invalid", str(error)))
    return MadeFile(Outcome("finished", ""), path.read_bytes())


def return_file_unchanged(made: MadeFile) -> MadeFile:
    """Return `made` unchanged: a cluster task that carries a file of the campaign's machine."""
    return made


def list_outcomes_as_results(made: Mapping[str, MadeFile | None]) -> list[Result]:
    """Return the outcome of each made file as a result; None entries are left out."""
    return [Result(name, file.outcome) for name, file in made.items() if file is not None]


@_register_task_thread()
def run_cells(
    context: CampaignContext,
    batch: CellBatch,
    sources: Mapping[str, MadeFile],
    *,
    alone: bool,
    concurrency: int,
) -> list[Result]:
    """Do a batch of runs on this cluster worker and return their evaluated results.

    `sources` are of their QPs, by key. `alone` gives them all cores of this machine, else one.
    """
    results = [*_yield_lost_for_other_versions(batch.jobs)]
    known = {result.run_id for result in results}
    jobs = [job for job in batch.jobs if job.run_id not in known]
    if not jobs:
        return results
    with ExitStack() as stack:
        cores = (
            sorted(os.sched_getaffinity(0))
            if alone
            else [stack.enter_context(hold_free_core_lock())]
        )
        executor, folder = stack.enter_context(
            _open_executor_and_folder(context, cores, concurrency)
        )
        paths = {key: folder / f"exact-{key}.npz" for key in sources}
        for key, path in paths.items():
            path.write_bytes(sources[key].data)
        here = CellBatch(batch.kind, jobs, batch.isolated)
        return [*results, *_run_batch(executor, here, paths)]


def _run_batch(
    executor: CellExecutor, batch: Batch, sources: Mapping[str, Path]
) -> Sequence[Result]:
    """Run one batch of cells or files on this machine and return its results."""
    executor.submit(batch, sources)
    ((_, results),) = executor.wait_for_batches()
    return results


def _yield_lost_for_other_versions(jobs: Sequence[CellJob]) -> Iterator[Result]:
    """Yield a "lost" result for each run whose solver has another version here than planned."""
    node = os.uname().nodename
    for job in jobs:
        wanted = job.library.version_and_build_text
        # A plug-in comes with the cells.
        identity = (
            wanted if job.cell.solver_module else _find_library_version_and_build(job.cell.solver)
        )
        if identity != wanted:
            where = f"{job.cell.solver} {identity or 'missing'} on {node}"
            cause = Outcome("lost", f"{where}, {wanted} where the campaign was started")
            yield Result(job.run_id, cause)


@cache
def _find_library_version_and_build(solver: str) -> str:
    """Return version and build of a solver's library on this worker."""
    return find_solver_availability(solver).version_and_build_text


_get_forkserver = cache(start_forkserver)
"""The starter of this worker's processes, made once."""


@contextmanager
def _open_executor_and_folder(
    context: CampaignContext, cores: list[int], concurrency: int = 1
) -> Iterator[tuple[CellExecutor, Path]]:
    """Yield an executor that does runs one at a time on these cores, and its temporary folder."""
    with ExitStack() as stack:
        place = stack.enter_context(make_temporary_folder_for_block(Path(tempfile.gettempdir())))
        modules = {}
        for i, (path, text) in enumerate(context.modules.items()):
            modules[path] = str(place / str(i) / Path(path).name)
            Path(modules[path]).parent.mkdir()
            Path(modules[path]).write_text(text, encoding="utf-8")
        executor = CellExecutor(
            _get_forkserver(),
            stack.enter_context(Scratch(place)),
            cores,
            1,
            context.progress,
            describe_worker().machine["id"],
            modules=modules,
            concurrency=concurrency,
        )
        yield stack.enter_context(executor), place
