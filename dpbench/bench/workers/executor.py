"""Run cells in processes of their own on the cores of this machine, and have them judged.

In one of two ways: batches side by side on the cores, for closed loops and random sequences, and
replays that are timed, interleaved, one worker at a time.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import TypeVar

import pyarrow as pa

from dpbench.bench.judge.rows import run_row
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.configuration import COLUMNS
from dpbench.bench.record.finished_batch import DAMAGE, BatchPart, Row, batch_part, unpacked
from dpbench.bench.record.raw_log import discard
from dpbench.bench.record.step_table import no_steps
from dpbench.bench.sequences.source import log_size
from dpbench.bench.workers.batch import CellBatch, Errand, ErrandBatch, Target
from dpbench.bench.workers.child import ENDED_TEMPLATE, WITHOUT_TEMPLATE
from dpbench.bench.workers.interleaved import IdleWorkers, ReplayGroup
from dpbench.bench.workers.leases import leased_machine
from dpbench.bench.workers.scratch import NoRoomError, Scratch
from dpbench.bench.workers.slots import AnyTask, in_slots
from dpbench.bench.workers.worker import BatchCell
from dpbench.errors import InputError
from dpbench.locks import ALONE, TOGETHER, Holder, Patience
from dpbench.solvers.table import Availability

Batch = TypeVar("Batch")
BATCH_CELLS, BATCH_BYTES = 32, 2**23
"""Closed loops that share a process, and the bytes of their logs, at most."""
WAITING = (
    "waiting for {}: while one campaign times replays on this machine, no other runs cells "
    "(--no-wait, --wait SECONDS)"
)


@dataclass(eq=False)
class CellJob:
    """A planned cell on its way through the campaign.

    machine_id : of the machine that its `run_id` is of.
    """

    planned: PlannedCell
    run_id: str
    library: Availability
    machine_id: str
    outcome: Outcome | None = None

    @property
    def cell(self) -> Cell:
        """Its cell."""
        return self.planned.cell

    @cached_property
    def source_key(self) -> str:
        """Of the file behind its QPs."""
        return self.cell.source_key(HARNESS_VERSION)


@dataclass(frozen=True)
class Result:
    """What became of a cell.

    part : the finished cells of its batch, one object for all of these; None where nothing is to be
        kept of it.
    """

    run_id: str
    outcome: Outcome
    part: BatchPart | None = None

    @property
    def is_lost(self) -> bool:
        """Whether an accident of the harness cost it."""
        return self.outcome.outcome == "lost"


def work_of(cell: Cell) -> int:
    """Steps a cell will take, for the progress bar."""
    return cell.steps * max(1, cell.rounds)


def name_of(cell: Cell) -> str:
    """What the progress bar calls a cell."""
    return f"{cell.solver} {cell.scenario_name or cell.sequence}"


@contextmanager
def _away_from(core: int) -> Iterator[None]:
    """Keep this process, whose progress bar redraws itself, off the core that is measured."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, before - {core} or before)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class Bench:
    """Runs cells in processes of their own and has them judged.

    Parameters
    ----------
    cores : those there are; slots : how many processes may work side by side, on as many cores.
    machine_id : of this machine, for the rows of the cells.
    modules : where the files of plug-ins lie here, by where they lie for whoever planned the cells.
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
        patience: Patience = Patience(),  # noqa: B008 - frozen
    ) -> None:
        self._context, self._scratch, self.progress = context, scratch, progress
        self._cores, self._slots = cores, cores[:slots]
        self._machine_id, self._modules = machine_id, modules or {}
        self._concurrency, self._waited_for = concurrency, ""
        self._holder, self._patience = Holder(work), patience

    def make_files(
        self,
        target: Target,
        descriptions: Mapping[Path, str],
        *,
        limit_s: float | None = None,
    ) -> Iterator[Errand]:
        """Make files from their descriptions, several in one process; as in `Errand`.

        Yields
        ------
        The errand of each file when those that shared its process are done.
        """
        folder, most = self._scratch.folder(), batch_cells(len(descriptions), len(self._slots))
        errands = [Errand(text, path, limit_s) for path, text in descriptions.items()]
        batches = [
            ErrandBatch(self._context, target, errands[i : i + most], folder)
            for i in range(0, len(errands), most)
        ]
        for batch in self._in_slots(batches, self._slots):
            yield from batch.errands

    def batches(
        self,
        jobs: Sequence[CellJob],
        sources: Mapping[str, Path],
        what: str,
        *,
        most: int | None = None,
    ) -> Iterator[Result]:
        """Run closed loops, or random sequences, and judge each batch right after it ran.

        Cells of one configuration share a process, one after the other: `most` of them, by default
        as many as keep all slots busy to the end.

        Yields
        ------
        The results of each batch when it is done.
        """
        sizes, lost = self._sizes(jobs, sources)
        yield from lost
        if not sizes:
            return
        batches = _batches(sizes, most or batch_cells(len(sizes), len(self._slots)))
        # A batch keeps the logs of all its cells until they are judged.
        needs = sorted(sum(sizes[job] for job in batch) for batch in batches)
        try:
            folder = self._scratch.folder(sum(needs[-len(self._slots) :]), what)
        except NoRoomError as error:
            yield from (self._lost(job, str(error)) for job in sizes)
            return
        by_id = {job.run_id: job for job in sizes}
        for batch in self._in_batches(batches, sources, folder):
            outcomes = {by_id[run_id]: outcome for run_id, outcome in batch.outcomes.items()}
            for job in outcomes:
                self.progress.advance(work_of(job.cell), name_of(job.cell))
            yield from self._results(outcomes, batch.records, folder)

    def replays(
        self, groups: Sequence[Sequence[CellJob]], sources: Mapping[str, Path]
    ) -> Iterator[Result]:
        """Replay sequences one after the other, each through its group of configurations, and
        judge each group right after it ran.

        A configuration has one process for all sequences, unless it ends.
        """
        with closing(IdleWorkers(self._context, self._cores[-1])) as processes:
            for jobs in groups:
                yield from self._replays_of_one(jobs, sources, processes)

    def _replays_of_one(
        self, jobs: Sequence[CellJob], sources: Mapping[str, Path], processes: IdleWorkers
    ) -> Iterator[Result]:
        """Replay one sequence through all its configurations, interleaved, then judge them all."""
        sizes, lost = self._sizes(jobs, sources)
        yield from lost
        if not sizes:
            return
        what = f"the replays of {jobs[0].cell.sequence}"
        try:
            folder = self._scratch.folder(sum(sizes.values()), what)
        except NoRoomError as error:
            yield from (self._lost(job, str(error)) for job in sizes)
            return
        outcomes = self._by_turns([*sizes], _source(jobs[0], sources), folder, processes)
        stepped = [
            job
            for job in sizes
            if outcomes[job.run_id].outcome != "lost" and (folder / f"{job.run_id}.raw").exists()
        ]
        shares = [stepped[i :: len(self._cores)] for i in range(len(self._cores))]
        # Judged on every core, whatever the slots: nothing is timed any more.
        ran, records = dict(outcomes), dict[str, bytes]()
        for batch in self._in_batches(filter(None, shares), sources, folder, ran):
            outcomes |= batch.outcomes
            records |= batch.records
        yield from self._results({job: outcomes[job.run_id] for job in sizes}, records, folder)

    def _by_turns(
        self, jobs: Sequence[CellJob], source: Path, folder: Path, processes: IdleWorkers
    ) -> dict[str, Outcome]:
        """What became of replays that took turns, by run_id.

        Those whose template died run apart, one after the other, where the one that ends the next
        template is known; all others of them take turns once more.
        """
        cells = [(job.run_id, self._here(job.cell)) for job in jobs]
        outcomes = self._turns(cells, source, folder, processes)
        suspects = [entry for entry in cells if outcomes[entry[0]] == WITHOUT_TEMPLATE]
        for entry in suspects:
            outcomes |= self._turns([entry], source, folder, processes, alone=True)
        ended = (WITHOUT_TEMPLATE, ENDED_TEMPLATE)
        cleared = [entry for entry in suspects if outcomes[entry[0]] not in ended]
        if cleared:
            outcomes |= self._turns(cleared, source, folder, processes)
        return outcomes

    def _turns(
        self,
        cells: list[tuple[str, Cell]],
        source: Path,
        folder: Path,
        processes: IdleWorkers,
        *,
        alone: bool = False,
    ) -> dict[str, Outcome]:
        """What became of replays of one sequence that took turns once."""
        name, core = cells[0][1].sequence, self._cores[-1]
        rounds = max(cell.rounds for _, cell in cells)
        share = sum(work_of(cell) for _, cell in cells) // (rounds + 1)
        for run_id, _ in cells:
            discard(folder / f"{run_id}.raw")
        group = ReplayGroup(processes, folder, source, cells, alone=alone)
        how = ALONE if self._concurrency == 1 else TOGETHER
        with self._machine(how) as held, _away_from(core):
            for r in group.run():
                self.progress.advance(share, f"replay {name}, round {r}")
        if not held:
            self._concurrency = max(2, self._concurrency)
        return group.outcomes

    def _sizes(
        self, jobs: Sequence[CellJob], sources: Mapping[str, Path]
    ) -> tuple[dict[CellJob, int], list[Result]]:
        """What each log takes [B]; jobs whose source cannot be read are not in it but lost."""
        sizes: dict[CellJob, int] = {}
        lost: list[Result] = []
        known: dict[tuple[object, ...], int] = {}
        for job in jobs:
            cell = job.cell
            alike = job.source_key, cell.sequence, cell.mode, cell.steps, cell.rounds
            try:
                if alike not in known:
                    known[alike] = log_size(cell, _source(job, sources))
                sizes[job] = known[alike]
            except InputError as error:
                lost.append(self._lost(job, str(error)))
        return sizes, lost

    def _lost(self, job: CellJob, cause: str) -> Result:
        self.progress.advance(work_of(job.cell), "lost")
        return Result(job.run_id, Outcome("lost", cause))

    def _here(self, cell: Cell) -> Cell:
        """The cell with its plug-in where that lies on this machine."""
        module = self._modules.get(cell.solver_module)
        return cell if module is None else replace(cell, solver_module=module)

    def _in_batches(
        self,
        batches: Iterable[Sequence[CellJob]],
        sources: Mapping[str, Path],
        folder: Path,
        ran: Mapping[str, Outcome] | None = None,
    ) -> Iterator[CellBatch]:
        """Run and judge batches side by side; each when it is done.

        Parameters
        ----------
        ran : what became of cells that were run before, and are only judged, on all cores.
        """
        tasks = []
        for jobs in batches:
            cells = [self._batch_cell(job, sources, (ran or {}).get(job.run_id)) for job in jobs]
            tasks.append(CellBatch(self._context, folder, cells, to_run=ran is None))
        yield from self._in_slots(tasks, self._slots if ran is None else self._cores)

    def _in_slots(self, tasks: Sequence[AnyTask], cores: Sequence[int]) -> Iterator[AnyTask]:
        """As `in_slots`, while nobody times replays on this machine."""
        if tasks:
            with self._machine(TOGETHER):
                yield from in_slots(tasks, cores)

    def find_machine_free(self, *, times: bool) -> None:
        """Before anything runs, where patience ends: BusyError at its end.

        Parameters
        ----------
        times : whether replays will be timed, which takes all of the machine.
        """
        if self._patience.required and self._patience.limit_s is not None:
            with self._machine(ALONE if times and self._concurrency == 1 else TOGETHER):
                pass

    def _machine(self, how: int) -> AbstractContextManager[bool]:
        return leased_machine(
            how, self._holder, patience=self._patience, say_waiting=self._say_waiting
        )

    def _say_waiting(self, holders: str) -> None:
        if holders != self._waited_for:
            self.progress.waiting(WAITING.format(holders))
        self._waited_for = holders

    def _batch_cell(
        self, job: CellJob, sources: Mapping[str, Path], outcome: Outcome | None
    ) -> BatchCell:
        return BatchCell(
            job.run_id,
            job.cell.to_json(),
            job.cell.limit_s,
            _source(job, sources),
            outcome,
            job.library,
            self._machine_id,
            self._modules.get(job.cell.solver_module, job.cell.solver_module),
            self._concurrency_of(job.cell),
        )

    def _concurrency_of(self, cell: Cell) -> int | None:
        """Of a replay that is timed, the column of that name; None of every other cell."""
        return self._concurrency if cell.is_timed else None

    def _results(
        self, outcomes: Mapping[CellJob, Outcome], records: Mapping[str, bytes], folder: Path
    ) -> Iterator[Result]:
        """Return the results of a batch, and leave nothing in `folder` of what it left there.

        Parameters
        ----------
        records : what the referee made of the steps of cells that left some, by run_id.
        """
        kept: dict[str, tuple[Row, pa.RecordBatch]] = {}
        became = dict(outcomes)
        for job, outcome in outcomes.items():
            if outcome.outcome != "lost":
                try:
                    kept[job.run_id] = self._kept(job, outcome, records.get(job.run_id))
                except DAMAGE as error:
                    became[job] = Outcome("lost", f"its record cannot be kept: {error}")
            discard(folder / f"{job.run_id}.raw")
            for suffix in ("json", "judged", "evaluated.json"):
                # What stands in a file's place by somebody else's doing goes with the folder.
                with suppress(OSError):
                    (folder / f"{job.run_id}.{suffix}").unlink()
        part = batch_part(kept) if kept else None
        for job, outcome in became.items():
            yield Result(job.run_id, outcome, part if job.run_id in kept else None)

    def _kept(
        self, job: CellJob, outcome: Outcome, record: bytes | None
    ) -> tuple[Row, pa.RecordBatch]:
        """Return the row and the steps of a cell; ValueError where it should have left some."""
        if record is not None:
            return unpacked(record)
        if outcome.outcome in ("finished", "timed_out"):
            raise ValueError("the steps it made went away")
        about = job.run_id, job.cell, outcome, job.library, self._machine_id
        row = run_row(*about, None, None, concurrency=self._concurrency_of(job.cell))
        return row, no_steps()


def _source(job: CellJob, sources: Mapping[str, Path]) -> Path:
    """The file behind the QPs of a job."""
    return sources[job.source_key]


def batch_cells(cells: int, slots: int) -> int:
    """How many of so many cells share a process at most: as many as keep all slots busy to the
    end."""
    return min(BATCH_CELLS, max(1, cells // (4 * slots)))


def configuration_key(cell: Cell) -> tuple[str, ...]:
    """Cells with the same key may share a process."""
    return (cell.mode, cell.backup, *(getattr(cell, name) for name in COLUMNS))


def alternating(of_configurations: Iterable[Sequence[Batch]]) -> list[Batch]:
    """Return of the batches of several configurations the first of each, then the second of each,
    and so on: all of them run the same sea at about the same time, whose source is kept."""
    turns = zip_longest(*of_configurations)
    return [batch for turn in turns for batch in turn if batch is not None]


def _batches(sizes: Mapping[CellJob, int], most: int) -> list[list[CellJob]]:
    """Jobs that share a process, by the sizes of their logs [B]: those of one configuration, and
    configurations by turns.

    No more than `most`, and than the memory for logs has room for.
    """
    batches: dict[tuple[str, ...], list[list[CellJob]]] = {}
    room: dict[tuple[str, ...], int] = {}
    for job, size in sizes.items():
        key = configuration_key(job.cell)
        alike = batches.setdefault(key, [])
        looped = job.cell.mode == "closed_loop"
        if not alike or (looped and (len(alike[-1]) >= most or size > room[key])):
            alike.append([])
            room[key] = BATCH_BYTES
        alike[-1].append(job)
        room[key] -= size
    return alternating(batches.values())
