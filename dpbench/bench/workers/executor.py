"""Run batches in processes on the cores of this machine, and have them judged.

Closed loops, random sequences and files run side by side on the cores; timed replays run
interleaved, one worker at a time.
"""

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext
from pathlib import Path
from secrets import token_hex
from typing import Any, Generic, TypeVar

from dpbench.bench.judge.rows import make_run_row
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import delete_log_and_layout
from dpbench.bench.record.step_table import BatchPart, make_batch_part, make_empty_record_batch
from dpbench.bench.sequences.source import log_size
from dpbench.bench.workers.batch import CellRun, FileRun
from dpbench.bench.workers.child import FORKSERVER_DIED, KILLED_FORKSERVER, Child
from dpbench.bench.workers.interleaved import IdleWorkers, ReplayGroup
from dpbench.bench.workers.jobs import Batch, CellBatch, CellJob, FileBatch, Result, count_steps
from dpbench.bench.workers.scratch import NoRoomError, Scratch
from dpbench.bench.workers.worker import BatchCell
from dpbench.errors import InputError
from dpbench.locks import EXCLUSIVE, SHARED, Holder, WaitLimit, hold_machine_lock

STEP_SHOWN_S = 1.0
"""Interval between two looks at the step of a reference loop [s]."""
POLL_S = 0.1  # The end of a process is noticed at once; this is for what takes too long


AnyTask = TypeVar("AnyTask", bound=CellRun | FileRun)


class CorePool(Generic[AnyTask]):
    """A queue of tasks and the cores that run them, one task per core at a time.

    watch : called with each running task and its process while they are waited for.
    """

    def __init__(
        self, cores: Sequence[int], watch: Callable[[AnyTask, Child], None] | None = None
    ) -> None:
        self._free, self._watch = list(cores), watch
        self._waiting = deque[AnyTask]()
        self._running: list[tuple[AnyTask, Child, int]] = []

    def __len__(self) -> int:
        return len(self._waiting) + len(self._running)

    def add(self, task: AnyTask) -> None:
        """Queue a task, to be started when a processor core is free."""
        self._waiting.append(task)

    def wait_for_tasks(self) -> Iterator[AnyTask]:
        """Wait until a task has ended, if there is any; yield those that have."""
        ended: list[AnyTask] = []
        while len(self) and not ended:
            while self._waiting and self._free:
                task, core = self._waiting.popleft(), self._free.pop()
                self._running.append((task, task.start(core), core))
            wait([child.process.sentinel for _, child, _ in self._running], POLL_S)
            for entry in list(self._running):
                task, child, core = entry
                if child.process.is_alive() and not child.kill_if_overdue():
                    if self._watch is not None:
                        self._watch(task, child)
                    continue
                child.join()
                self._running.remove(entry)
                following = task.start_next(child, core)
                if following is None:
                    self._free.append(core)
                    ended.append(task)
                else:
                    self._running.append((task, following, core))
        yield from ended


def run_on_cores(tasks: Sequence[AnyTask], cores: Sequence[int]) -> Iterator[AnyTask]:
    """Run tasks on cores, one per core at a time; yield each when it has ended."""
    pool = CorePool[AnyTask](cores)
    for task in tasks:
        pool.add(task)
    while len(pool):
        yield from pool.wait_for_tasks()


Sources = Mapping[str, Path]  # The files behind the QPs of a batch, by key
WAITING = (
    "waiting for {}: while one dpbench command times replays, no other can use this machine "
    "(--wait SECONDS, or `wait_s` in Python, limits the wait)"
)


@contextmanager
def _avoid_core(core: int) -> Iterator[None]:
    """Keep this process off one core during the block, as times are measured there."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, before - {core} or before)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class CellExecutor(ExitStack):
    """Executor of batches of runs and files in worker processes on this machine's cores.

    slots : processes side by side, on as many of the `cores`.
    machine_id : of this machine, for the rows of the cells.
    modules : paths of plug-ins on this machine, by their paths where the cells were planned.
    concurrency : of timed replays, see the column of that name.
    work : the result folder, for campaigns that wait for this one.
    patience : with other campaigns on this machine.
    """

    def __init__(
        self,
        context: ForkServerContext,
        scratch: Scratch,
        cores: list[int],
        slots: int,
        progress: Progress,
        machine_id: str = "",
        *,
        modules: Mapping[str, str] | None = None,
        concurrency: int = 1,
        work: str = "a campaign",
        patience: WaitLimit = WaitLimit(),  # noqa: B008 - frozen
    ) -> None:
        super().__init__()
        self._context, self._scratch, self.progress = context, scratch, progress
        self._cores, self._machine_id, self._modules = cores, machine_id, modules or {}
        self._concurrency, self._waited_for = concurrency, ""
        self._holder, self._patience = Holder(work), patience
        self._pool = CorePool[CellRun | FileRun](cores[:slots], self._show_step)
        self._shown_s = 0.0
        self._replays = deque[tuple[CellBatch, Sources]]()
        self._refused: list[tuple[Batch, list[Result]]] = []
        self._log_bytes: dict[CellRun, int] = {}
        self._lost: dict[CellRun, list[Result]] = {}
        self._turns: dict[str, str] = {}  # of each run_id the replays that it was timed with
        self._idle = IdleWorkers(context, cores[-1])
        self._sharing = self.enter_context(ExitStack())
        self.callback(self._idle.close)

    def submit(self, batch: Batch, sources: Sources) -> None:
        """Start or queue a batch of runs or files; timed replays only while there is no other."""
        if isinstance(batch, FileBatch):
            self._start_batch_in_pool(FileRun(self._context, batch, self._scratch.choose_folder()))
        elif batch.is_timed:
            self._replays.append((batch, sources))
        else:
            self._submit_cells(batch, sources)

    def wait_for_batches(self) -> Iterator[tuple[Batch, list[Result]]]:
        """Wait for batches of runs or files; yield each with its results, of lost cells none."""
        while self._refused:
            yield self._refused.pop()
        if self._replays:
            batch, sources = self._replays.popleft()
            yield batch, self._time_replays(batch, sources)
        for run in self._pool.wait_for_tasks():
            results = run.results if isinstance(run, FileRun) else self._collect_results(run)
            if not len(self._pool):
                self._sharing.close()
            yield run.batch, results

    def _start_batch_in_pool(self, run: CellRun | FileRun) -> None:
        """Start a batch in the pool; lock the machine before the first one."""
        self._idle.close()
        if not len(self._pool):
            self._sharing.enter_context(self._lock_machine(SHARED))
        self._pool.add(run)

    def _show_step(self, task: CellRun | FileRun, child: Child) -> None:
        """Show the step of a reference loop that takes long, every second."""
        now_s = time.monotonic()
        if now_s - self._shown_s < STEP_SHOWN_S or not isinstance(task, FileRun):
            return
        if step := task.describe_step(child):
            self._shown_s = now_s
            self.progress.advance(0, step)

    def _submit_cells(self, batch: CellBatch, sources: Sources) -> None:
        """Queue a batch of untimed runs; runs without room for their raw logs are "lost"."""
        sizes, lost = self._measure_logs(batch.jobs, sources)
        # A batch keeps the logs of all its cells until they are judged.
        need = sum(sizes.values())
        try:
            folder = self._scratch.choose_folder(need + sum(self._log_bytes.values()), batch.kind)
        except NoRoomError as error:
            lost += [_lost_result(job, str(error)) for job in sizes]
            sizes = {}
        if not sizes:
            self._refused.append((batch, lost))
            return
        cells = [self._make_batch_cell(job, sources) for job in sizes]
        run = CellRun(self._context, batch, folder, cells)
        self._log_bytes[run], self._lost[run] = need, lost
        self._start_batch_in_pool(run)

    def _collect_results(self, run: CellRun) -> list[Result]:
        """Return the results of a batch that has ended, with the cells it lost."""
        self._log_bytes.pop(run)
        ended = (job for job in run.batch.jobs if job.run_id in run.outcomes)
        outcomes = {job: run.outcomes[job.run_id] for job in ended}
        return self._build_results(outcomes, run.parts, run.folder) + self._lost.pop(run)

    def _time_replays(self, batch: CellBatch, sources: Sources) -> list[Result]:
        """Replay QPs with all solvers in interleaved rounds, then judge them; return results."""
        sizes, lost = self._measure_logs(batch.jobs, sources)
        if not sizes:
            return lost
        what = f"the replays of {batch.jobs[0].cell.sequence}"
        try:
            folder = self._scratch.choose_folder(sum(sizes.values()), what)
        except NoRoomError as error:
            return lost + [_lost_result(job, str(error)) for job in sizes]
        outcomes = self._run_turns_with_retries(batch, [*sizes], sources, folder)
        stepped = [
            job
            for job in sizes
            if outcomes[job.run_id].outcome != "lost" and (folder / f"{job.run_id}.raw").exists()
        ]
        cells = [self._make_batch_cell(job, sources, outcomes[job.run_id]) for job in stepped]
        shares = filter(None, (cells[i :: len(self._cores)] for i in range(len(self._cores))))
        # Judged on every core, whatever the slots: nothing is timed any more.
        runs = [CellRun(self._context, batch, folder, share, to_run=False) for share in shares]
        parts: list[BatchPart] = []
        unanswered = {job.run_id for job in stepped}
        with self._lock_machine(SHARED):
            for run in run_on_cores(runs, self._cores):
                outcomes |= run.outcomes
                parts += run.parts
                unanswered -= run.outcomes.keys()
        unanswered -= {name for part in parts for name in part.outcomes}
        answered = {j: outcomes[j.run_id] for j in sizes if j.run_id not in unanswered}
        return lost + self._build_results(answered, parts, folder)

    def _run_turns_with_retries(
        self, batch: CellBatch, jobs: Sequence[CellJob], sources: Sources, folder: Path
    ) -> dict[str, Outcome]:
        """Do interleaved replays, suspects of a crash alone first; return outcomes by run_id."""
        modules = ((job, self._plugin_path(job)) for job in jobs)
        cells = [(job.run_id, replace(job.cell, solver_module=path)) for job, path in modules]
        turns = partial(self._run_turns, batch, sources[jobs[0].source_key], folder)
        outcomes = turns(cells)
        suspects = [entry for entry in cells if outcomes[entry[0]] == FORKSERVER_DIED]
        for entry in suspects:
            outcomes |= turns([entry], alone=True)
        ended = (FORKSERVER_DIED, KILLED_FORKSERVER)
        cleared = [entry for entry in suspects if outcomes[entry[0]] not in ended]
        if cleared:
            outcomes |= turns(cleared)
        return outcomes

    def _run_turns(
        self,
        batch: CellBatch,
        source: Path,
        folder: Path,
        cells: list[tuple[str, Cell]],
        *,
        alone: bool = False,
    ) -> dict[str, Outcome]:
        """Replay a sequence with solvers in interleaved rounds; return the outcomes by run_id."""
        name, core = cells[0][1].sequence, self._cores[-1]
        rounds = max(cell.rounds for _, cell in cells)
        share = sum(count_steps(cell) for _, cell in cells) // (rounds + 1)
        for run_id, _ in cells:
            delete_log_and_layout(folder / f"{run_id}.raw")
        # Replays done again after a crash were not interleaved with the others.
        self._turns |= dict.fromkeys((run_id for run_id, _ in cells), token_hex(8))
        group = ReplayGroup(self._idle, folder, source, cells, alone=alone)
        how = EXCLUSIVE if self._concurrency == 1 else SHARED
        with self._lock_machine(how) as held, _avoid_core(core):
            for r in group.run_rounds():
                self.progress.advance(share, f"replay {name}, round {r}")
                batch.shown_work += share
        if not held:
            self._concurrency = max(2, self._concurrency)
        return group.outcomes

    def _measure_logs(
        self, jobs: Sequence[CellJob], sources: Sources
    ) -> tuple[dict[CellJob, int], list[Result]]:
        """Return each run's raw log size [B]; and "lost" results where its QPs are unreadable."""
        sizes: dict[CellJob, int] = {}
        lost: list[Result] = []
        known: dict[tuple[object, ...], int] = {}
        for job in jobs:
            cell = job.cell
            alike = job.source_key, cell.sequence, cell.mode, cell.steps, cell.rounds
            try:
                if alike not in known:
                    known[alike] = log_size(cell, sources[job.source_key])
                sizes[job] = known[alike]
            except InputError as error:
                lost.append(_lost_result(job, str(error)))
        return sizes, lost

    def check_machine_free(self, *, times: bool) -> None:
        """Raise BusyError if other campaigns use the machine too long; `times` needs all of it."""
        if self._patience.limit_s is not None:
            with self._lock_machine(EXCLUSIVE if times and self._concurrency == 1 else SHARED):
                pass

    def _lock_machine(self, how: int) -> AbstractContextManager[bool]:
        """Return a lock of this machine, shared or alone, that shows which campaigns it awaits."""
        return hold_machine_lock(
            how, self._holder, patience=self._patience, say_waiting=self._report_wait
        )

    def _report_wait(self, holders: str) -> None:
        """Show which campaigns are being waited for, once for each change."""
        if holders != self._waited_for:
            self.progress.waiting(WAITING.format(holders))
        self._waited_for = holders

    def _plugin_path(self, job: CellJob) -> str:
        """Return the path of a run's solver plug-in file on this machine."""
        return self._modules.get(job.cell.solver_module, job.cell.solver_module)

    def _make_batch_cell(
        self, job: CellJob, sources: Sources, outcome: Outcome | None = None
    ) -> BatchCell:
        """Make the description of a cell that a worker process gets, with its source file."""
        cell, source = job.cell, sources[job.source_key]
        about = outcome, job.library, self._machine_id, self._plugin_path(job)
        described = job.run_id, cell.to_json(), cell.limit_s, source
        return BatchCell(*described, *about, **self._describe_timing(job))

    def _describe_timing(self, job: CellJob) -> dict[str, Any]:
        """Return the columns of a run's row that say when and with which others it was timed."""
        return {
            "concurrency": self._concurrency if job.cell.is_timed else None,
            "campaign_utc": job.campaign_utc,
            "turns": self._turns.get(job.run_id, ""),
        }

    def _build_results(
        self, outcomes: Mapping[CellJob, Outcome], parts: Sequence[BatchPart], folder: Path
    ) -> list[Result]:
        """Build a result for every outcome: its part of the tables, or a row without steps."""
        kept = {name: part for part in parts for name in part.outcomes}
        became, without_steps = dict(outcomes), {}
        for job, outcome in outcomes.items():
            if outcome.outcome in ("finished", "timed_out") and job.run_id not in kept:
                detail = "its record cannot be stored: its steps were removed"
                became[job] = Outcome("lost", detail)
            elif outcome.outcome != "lost" and job.run_id not in kept:
                about = job.run_id, job.cell, outcome, job.library, self._machine_id, None, None
                without_steps[job.run_id] = (
                    make_run_row(*about, **self._describe_timing(job)),
                    make_empty_record_batch(),
                )
            delete_log_and_layout(folder / f"{job.run_id}.raw")
            for suffix in ("json", "judged", "evaluated.json"):
                # What somebody else put in a file's place goes with the folder.
                with suppress(OSError):
                    (folder / f"{job.run_id}.{suffix}").unlink()
        if without_steps:
            kept |= dict.fromkeys(without_steps, make_batch_part(without_steps))
        turn = {part: i for i, part in enumerate(kept.values())}
        results = [
            Result(job.run_id, outcome, None if outcome.outcome == "lost" else kept[job.run_id])
            for job, outcome in became.items()
        ]
        return sorted(results, key=lambda result: turn[result.part] if result.part else -1)


def _lost_result(job: CellJob, cause: str) -> Result:
    """Return the result of a cell that an accident of the harness ended."""
    return Result(job.run_id, Outcome("lost", cause))
