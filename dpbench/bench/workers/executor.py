"""Run cells in processes of their own, have them judged, and keep what is finished.

In one of two ways: batches side by side on the cores, for closed loops and random sequences, and
replays that are timed, interleaved, one worker at a time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.judge.rows import run_row
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.cell_store import CellStore, packed
from dpbench.bench.record.configuration import COLUMNS
from dpbench.bench.record.raw_log import discard
from dpbench.bench.record.step_table import no_steps
from dpbench.bench.sequences.source import log_size, source_key
from dpbench.bench.workers.batch import CellBatch
from dpbench.bench.workers.child import with_log
from dpbench.bench.workers.interleaved import ReplayGroup
from dpbench.bench.workers.scratch import NoRoomError, Scratch
from dpbench.bench.workers.slots import Errand, in_slots
from dpbench.bench.workers.worker import BatchCell
from dpbench.errors import InputError
from dpbench.solvers.table import Availability

BATCH_CELLS, BATCH_BYTES = 32, 2**23
"""Closed loops that share a process, and the bytes of their logs, at most."""


@dataclass(eq=False)
class CellJob:
    """A planned cell on its way through the campaign."""

    planned: PlannedCell
    run_id: str
    library: Availability
    outcome: Outcome | None = None

    @property
    def cell(self) -> Cell:
        """Its cell."""
        return self.planned.cell

    @cached_property
    def source_key(self) -> str:
        """Of the file behind its QPs."""
        return source_key(self.cell, HARNESS_VERSION)

    @property
    def is_lost(self) -> bool:
        """Whether an accident of the harness cost it."""
        return self.outcome is not None and self.outcome.outcome == "lost"


def work_of(cell: Cell) -> int:
    """Steps a cell will take, for the progress bar."""
    return cell.steps * max(1, cell.rounds)


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
    machine_id : of `machine.json`, for the rows of the cells.
    """

    def __init__(
        self,
        context: ForkServerContext,
        scratch: Scratch,
        store: CellStore,
        cores: list[int],
        slots: int,
        progress: Progress,
        machine_id: str = "",
    ) -> None:
        self._context, self._scratch, self.progress = context, scratch, progress
        self._store, self._cores, self._slots = store, cores, cores[:slots]
        self._machine_id = machine_id
        self._folder = store.folder  # that of the logs at hand, see `_with_room`

    def make_files(
        self,
        target: Callable[[str, Path, str, int, Path], None],
        descriptions: Mapping[Path, str],
        *,
        limit_s: float | None = None,
    ) -> Iterator[Errand]:
        """Make files from their descriptions, each in a process of its own; as in `Errand`.

        Yields
        ------
        The errand of each file when its process has ended.
        """
        folder = self._scratch.folder()
        errands = [
            Errand(self._context, target, text, folder, path, limit_s=limit_s)
            for path, text in descriptions.items()
        ]
        return in_slots(errands, self._slots)

    def batches(self, jobs: Sequence[CellJob], sources: dict[str, Path], what: str) -> None:
        """Run closed loops, or random sequences, and judge each batch right after it ran.

        Cells of one configuration share a process, one after the other.
        """
        sizes = self._sizes(jobs, sources)
        batches = _batches(sizes, len(self._slots))
        # A batch keeps the logs of all its cells until they are judged.
        needs = sorted(sum(sizes[job] for job in batch) for batch in batches)
        if not sizes or not self._with_room(sizes, sum(needs[-len(self._slots) :]), what):
            return
        by_id = {job.run_id: job for job in sizes}
        for outcomes in self._in_batches(batches, sources):
            for run_id, outcome in outcomes.items():
                job, cell = by_id[run_id], by_id[run_id].cell
                job.outcome = outcome
                self._put_away(job)
                name = cell.scenario_name or cell.sequence
                self.progress.advance(work_of(cell), f"{cell.solver} {name}")

    def replays(self, jobs: Sequence[CellJob], sources: dict[str, Path]) -> None:
        """Replay one sequence through all its configurations, interleaved, then judge them all."""
        name, core = jobs[0].cell.sequence, self._cores[-1]
        sizes = self._sizes(jobs, sources)
        if not sizes or not self._with_room(sizes, sum(sizes.values()), f"the replays of {name}"):
            return
        cells = [(job.run_id, job.cell) for job in sizes]
        group = ReplayGroup(self._context, self._folder, _source(jobs[0], sources), core, cells)
        rounds = max(cell.rounds for _, cell in cells)
        share = sum(work_of(cell) for _, cell in cells) // (rounds + 1)
        with _away_from(core):
            for r in group.run():
                self.progress.advance(share, f"replay {name}, round {r}")
        raws = {job: self._folder / f"{job.run_id}.raw" for job in sizes}
        for job, raw in raws.items():
            job.outcome = with_log(group.outcomes[job.run_id], raw)
        stepped = [job for job, raw in raws.items() if raw.exists() and not job.is_lost]
        shares = [stepped[i :: len(self._cores)] for i in range(len(self._cores))]
        # Judged on every core, whatever the slots: nothing is timed any more.
        evaluated = self._in_batches(filter(None, shares), sources, self._cores, to_run=False)
        lost = {run_id: outcome for outcomes in evaluated for run_id, outcome in outcomes.items()}
        for job in sizes:
            job.outcome = lost.get(job.run_id, job.outcome)
            self._put_away(job)

    def _sizes(self, jobs: Sequence[CellJob], sources: dict[str, Path]) -> dict[CellJob, int]:
        """What each log takes [B]; jobs whose source cannot be read are lost, and not in it."""
        sizes: dict[CellJob, int] = {}
        known: dict[tuple[object, ...], int] = {}
        for job in jobs:
            cell = job.cell
            alike = job.source_key, cell.sequence, cell.mode, cell.steps, cell.rounds
            try:
                if alike not in known:
                    known[alike] = log_size(cell, _source(job, sources))
                sizes[job] = known[alike]
            except InputError as error:
                self._lose(job, str(error))
        return sizes

    def _with_room(self, jobs: Iterable[CellJob], need: int, what: str) -> bool:
        """Choose where the logs of `jobs` lie; without room for `need` bytes they are lost."""
        try:
            self._folder = self._scratch.folder(need, what)
        except NoRoomError as error:
            for job in jobs:
                self._lose(job, str(error))
            return False
        return True

    def _lose(self, job: CellJob, cause: str) -> None:
        job.outcome = Outcome("lost", cause)
        self.progress.advance(work_of(job.cell), "lost")

    def _in_batches(
        self,
        batches: Iterable[Sequence[CellJob]],
        sources: dict[str, Path],
        cores: Sequence[int] | None = None,
        *,
        to_run: bool = True,
    ) -> Iterator[dict[str, Outcome]]:
        """Run and judge batches side by side; the outcomes of each when it is done, by run_id."""
        tasks = []
        for jobs in batches:
            cells = [
                BatchCell(
                    job.run_id,
                    job.cell.to_json(),
                    job.cell.limit_s,
                    _source(job, sources),
                    job.outcome,
                    job.library,
                    self._machine_id,
                )
                for job in jobs
            ]
            tasks.append(CellBatch(self._context, self._folder, cells, to_run=to_run))
        for batch in in_slots(tasks, cores or self._slots):
            yield batch.outcomes

    def _put_away(self, job: CellJob) -> None:
        """Keep what became of a cell, unless it was lost, and drop what it left behind."""
        outcome = job.outcome or Outcome("lost", "it was not run")
        if outcome.outcome != "lost":
            try:
                self._store.append(job.run_id, outcome.outcome, self._record(job, outcome))
            except OSError as error:
                outcome = Outcome("lost", f"it could not be kept: {error}")
        job.outcome = outcome
        discard(self._folder / f"{job.run_id}.raw")
        for suffix in ("json", "judged", "evaluated.json", "noise"):
            # What stands in a file's place by somebody else's doing goes with the folder.
            with suppress(OSError):
                (self._folder / f"{job.run_id}.{suffix}").unlink()

    def _record(self, job: CellJob, outcome: Outcome) -> bytes:
        """What the referee left of a cell; of one that left no steps its row."""
        if (self._folder / f"{job.run_id}.evaluated.json").exists():
            return (self._folder / f"{job.run_id}.judged").read_bytes()
        about = job.run_id, job.cell, outcome, job.library, self._machine_id
        return packed(run_row(*about, None, None), no_steps())


def _source(job: CellJob, sources: dict[str, Path]) -> Path:
    """The file behind the QPs of a job."""
    return sources[job.source_key]


def _batches(sizes: Mapping[CellJob, int], slots: int) -> list[list[CellJob]]:
    """Jobs that may share a process, by the sizes of their logs [B]: those of one configuration.

    No more than keep all slots busy to the end, and than the memory for logs has room for.
    """
    most = min(BATCH_CELLS, max(1, len(sizes) // (4 * slots)))
    batches: dict[tuple[str, ...], list[list[CellJob]]] = {}
    room: dict[tuple[str, ...], int] = {}
    for job, size in sizes.items():
        key = (job.cell.mode, *(getattr(job.cell, name) for name in COLUMNS))
        alike = batches.setdefault(key, [])
        looped = job.cell.mode == "closed_loop"
        if not alike or (looped and (len(alike[-1]) >= most or size > room[key])):
            alike.append([])
            room[key] = BATCH_BYTES
        alike[-1].append(job)
        room[key] -= size
    return [batch for alike in batches.values() for batch in alike]
