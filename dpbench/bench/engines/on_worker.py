"""What a worker of a cluster does for a campaign that was started elsewhere.

Cells run as on the campaign's own machine, in processes of their own that `Bench` starts; files lie
in a scratch folder of the worker's machine and are gone when a task ends. What comes and goes over
the network are bytes. Nothing here needs Dask.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.engines.engine import Kind, Target, by_source, interleaved, without_source
from dpbench.bench.progress import Silent
from dpbench.bench.record.cell import HARNESS_VERSION, Outcome
from dpbench.bench.record.descriptions import MachineDescription
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.workers.child import template_context
from dpbench.bench.workers.executor import BATCH_CELLS, Bench, CellJob, Result
from dpbench.bench.workers.leases import leased_core
from dpbench.bench.workers.scratch import Scratch
from dpbench.bench.workers.worker import make_source
from dpbench.errors import DpbenchError
from dpbench.solvers.table import available
from dpbench.temporary_folders import temporary_folder


@dataclass(frozen=True)
class About:
    """What a campaign wants to know of a worker before it gives it cells.

    may_start : whether it may start processes, as one that is a daemon itself may not.
    """

    harness_version: str
    may_start: bool
    machine: MachineDescription


@dataclass(frozen=True)
class Order:
    """What all tasks of a campaign have in common.

    harness_version : of the campaign; solvers : all that it runs.
    modules : the text of plug-ins, by the paths in the cells.
    """

    harness_version: str = HARNESS_VERSION
    solvers: tuple[str, ...] = ()
    modules: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Made:
    """A file that was made: its bytes, none where it failed."""

    outcome: Outcome
    data: bytes = b""


@cache
def about() -> About:
    """What is to be known of this process."""
    may_start = not multiprocessing.current_process().daemon
    return About(HARNESS_VERSION, may_start, describe_machine())


class TaskEndedError(DpbenchError):
    """The campaign of a task ended before it."""


_TASKS: set[int] = set()
"""The threads of tasks that run in this process."""
_ENDING = threading.Lock()


@contextmanager
def _task() -> Iterator[None]:
    """`end_tasks` may end the block."""
    thread = threading.get_ident()
    with _ENDING:
        _TASKS.add(thread)
    try:
        yield
    finally:
        with _ENDING:
            _TASKS.remove(thread)


def end_tasks() -> None:
    """End the tasks of this process, as Ctrl-C ends a campaign: what they wait for wakes them
    within a tenth of a second, and their folders go with them."""
    with _ENDING:
        for thread in _TASKS:
            set_error = ctypes.pythonapi.PyThreadState_SetAsyncExc
            set_error(ctypes.c_ulong(thread), ctypes.py_object(TaskEndedError))


@_task()
def make_files(
    order: Order, target: Target, texts: Mapping[str, str], limit_s: float | None
) -> list[Made]:
    """Make files from their descriptions by name, on a core of this machine; as in `Errand`."""
    with leased_core() as core, _bench(order, [core]) as (bench, folder):
        paths = {folder / name: text for name, text in texts.items()}
        errands = bench.make_files(target, paths, limit_s=limit_s)
        became = {errand.path: errand.outcome for errand in errands}
        return [_made(path, became[path]) for path in paths]


def _made(path: Path, outcome: Outcome) -> Made:
    return Made(outcome, path.read_bytes() if outcome.outcome == "finished" else b"")


def given(made: Made) -> Made:
    """A file that the campaign's machine had."""
    return made


@_task()
def run_cells(
    order: Order,
    kind: Kind,
    jobs: Sequence[CellJob],
    sources: Mapping[str, Made],
    *,
    unmade: Mapping[str, str],
    alone: bool,
    concurrency: int,
) -> list[Result]:
    """Run cells of one configuration, or replay one sequence through several, and judge them.

    Parameters
    ----------
    sources : what their QPs are made from, by key; unmade : what nobody else needs, to be made here
        from its description.
    alone : whether they have all cores of this machine; one of them else.
    concurrency : of timed replays, see the column of that name.
    """
    results = [*_of_other_versions(order, jobs)]
    with ExitStack() as stack:
        cores = sorted(os.sched_getaffinity(0)) if alone else [stack.enter_context(leased_core())]
        bench, folder = stack.enter_context(_bench(order, cores, concurrency))
        of_key = by_source(_others(jobs, results))
        paths = {key: folder / f"exact-{key}.npz" for key in of_key}
        for key, outcome in _put(bench, paths, sources, unmade):
            if outcome.outcome != "finished":
                results += without_source(of_key[key], outcome)
        jobs = _others(jobs, results)
        if not jobs:
            return results
        if kind == "replays":
            return [*results, *bench.replays(interleaved(jobs), paths)]
        return [*results, *bench.batches(jobs, paths, kind, most=BATCH_CELLS)]


def _put(
    bench: Bench, paths: Mapping[str, Path], sources: Mapping[str, Made], unmade: Mapping[str, str]
) -> Iterator[tuple[str, Outcome]]:
    """Put the sources of keys at their paths; yields each key with what became of its file."""
    for key in paths.keys() & sources.keys():
        paths[key].write_bytes(sources[key].data)
        yield key, sources[key].outcome
    keys = {paths[key]: key for key in paths.keys() & unmade.keys()}
    texts = {path: unmade[key] for path, key in keys.items()}
    for errand in bench.make_files(make_source, texts):
        yield keys[errand.path], errand.outcome


def _others(jobs: Sequence[CellJob], results: Sequence[Result]) -> list[CellJob]:
    """The jobs that have no result yet."""
    known = {result.run_id for result in results}
    return [job for job in jobs if job.run_id not in known]


def _of_other_versions(order: Order, jobs: Sequence[CellJob]) -> Iterator[Result]:
    """Jobs whose solver, or dpbench, is another one here than where the campaign was planned."""
    node = os.uname().nodename
    for job in jobs:
        if order.harness_version != HARNESS_VERSION:
            other = f"dpbench {HARNESS_VERSION} on {node}, {order.harness_version} of the campaign"
            yield Result(job.run_id, Outcome("lost", other))
            continue
        wanted = job.library.identity
        # A plug-in comes with the cells.
        identity = wanted if job.cell.solver_module else _identity(job.cell.solver)
        if identity != wanted:
            where = f"{job.cell.solver} {identity or 'missing'} on {node}"
            cause = Outcome("lost", f"{where}, {wanted} where the campaign was started")
            yield Result(job.run_id, cause)


@cache
def _identity(solver: str) -> str:
    return available(solver).identity


@cache
def _context(solvers: tuple[str, ...]) -> ForkServerContext:
    """Looking after kernels that were not compiled takes longer than a short cell."""
    return template_context(solvers)


@contextmanager
def _bench(order: Order, cores: list[int], concurrency: int = 1) -> Iterator[tuple[Bench, Path]]:
    """A bench with one slot on these cores, and a folder for the files it runs from."""
    with ExitStack() as stack:
        place = stack.enter_context(temporary_folder(Path(tempfile.gettempdir())))
        modules = {}
        for i, (path, text) in enumerate(order.modules.items()):
            modules[path] = str(place / str(i) / Path(path).name)
            Path(modules[path]).parent.mkdir()
            Path(modules[path]).write_text(text, encoding="utf-8")
        bench = Bench(
            _context(order.solvers),
            stack.enter_context(Scratch(place)),
            cores,
            1,
            Silent(),
            about().machine["id"],
            modules=modules,
            concurrency=concurrency,
        )
        yield bench, place
