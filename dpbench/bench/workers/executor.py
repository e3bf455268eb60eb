"""Run cells in processes of their own, have them judged, and keep what is finished.

In one of two ways: batches side by side on the cores, for closed loops and random sequences, and
replays that are timed, interleaved, one worker at a time.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.judge.closed_loop import Evaluated
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, OUTCOMES, Cell, Outcome
from dpbench.bench.record.configuration import COLUMNS
from dpbench.bench.record.raw_log import discard
from dpbench.bench.record.result_folder import write_json
from dpbench.bench.sequences.source import log_size, source_key
from dpbench.bench.workers.batch import CellBatch
from dpbench.bench.workers.child import with_log
from dpbench.bench.workers.interleaved import ReplayGroup
from dpbench.bench.workers.scratch import NoRoomError, Scratch
from dpbench.bench.workers.slots import Errand, in_slots
from dpbench.bench.workers.worker import BatchCell
from dpbench.errors import InputError, ResultsError
from dpbench.solvers.table import Availability


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

    @property
    def is_lost(self) -> bool:
        """Whether an accident of the harness cost it."""
        return self.outcome is not None and self.outcome.outcome == "lost"


class CellStore:
    """Finished cells on disk: `<run_id>.json` (the outcome) and `<run_id>.npz` (the columns)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def evaluated_path(self, job: CellJob) -> Path:
        """Where the judged columns of a cell go."""
        return self.folder / f"{job.run_id}.npz"

    def finished(self, job: CellJob) -> Outcome | None:
        """The outcome of a cell that was finished earlier, None if there is none to rely on.

        None is that of a cell that was lost, or of which something is damaged or gone.
        """
        try:
            text = (self.folder / f"{job.run_id}.json").read_text(encoding="utf-8")
            document = json.loads(text)
            with_steps = document.pop("with_steps")
            outcome = Outcome(**document)
        except (OSError, ValueError, TypeError, AttributeError, KeyError):
            return None
        if outcome.outcome not in OUTCOMES or outcome.outcome == "lost":
            return None
        sound = (self.evaluated(job) is not None) == with_steps
        return outcome if sound else None

    def finish(self, job: CellJob, outcome: Outcome, *, judged: bool = False) -> None:
        """Keep a cell's outcome; its columns were written before if it was `judged`.

        Columns of an earlier time do not stay beside the outcome of this one.
        """
        job.outcome = outcome
        with_steps = judged and outcome.outcome != "lost"
        if not with_steps:
            self.evaluated_path(job).unlink(missing_ok=True)
        document = outcome.__dict__ | {"with_steps": with_steps}
        write_json(self.folder / f"{job.run_id}.json", document)

    def evaluated(self, job: CellJob) -> Evaluated | None:
        """The judged columns of a cell, None if it left no steps, or they are damaged."""
        try:
            return Evaluated.load(self.evaluated_path(job))
        except ResultsError:
            return None


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
    """

    def __init__(
        self,
        context: ForkServerContext,
        scratch: Scratch,
        store: CellStore,
        cores: list[int],
        slots: int,
        progress: Progress,
    ) -> None:
        self._context, self._scratch, self.progress = context, scratch, progress
        self._store, self._cores, self._slots = store, cores, cores[:slots]
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
        """Run closed loops, or random sequences, and judge each batch right after it ran."""
        batches: dict[tuple[str, ...], list[CellJob]] = {}
        sizes = self._sizes(jobs, sources)
        for job in sizes:
            alone = job.cell.mode == "closed_loop"
            # Cells with the same configuration may share a process.
            key = (job.run_id,) if alone else tuple(getattr(job.cell, name) for name in COLUMNS)
            batches.setdefault(key, []).append(job)
        # A batch keeps the logs of all its cells until they are judged.
        needs = sorted(sum(sizes[job] for job in batch) for batch in batches.values())
        if not sizes or not self._with_room(sizes, sum(needs[-len(self._slots) :]), what):
            return
        by_id = {job.run_id: job for job in sizes}
        for outcomes in self._in_batches(batches.values(), sources):
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
        sizes = {}
        for job in jobs:
            try:
                sizes[job] = log_size(job.cell, _source(job, sources))
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
        self._store.finish(job, Outcome("lost", cause))
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
                    _source(job, sources),
                    self._store.evaluated_path(job),
                )
                for job in jobs
            ]
            limit_s = jobs[0].cell.limit_s
            tasks.append(CellBatch(self._context, self._folder, cells, limit_s, to_run=to_run))
        for batch in in_slots(tasks, cores or self._slots):
            yield batch.outcomes

    def _put_away(self, job: CellJob) -> None:
        """Keep the outcome of a cell and drop what it left behind."""
        judged = (self._folder / f"{job.run_id}.evaluated.json").exists()
        outcome = job.outcome or Outcome("lost", "it was not run")
        self._store.finish(job, outcome, judged=judged)
        discard(self._folder / f"{job.run_id}.raw")
        for suffix in ("json", "evaluated.json", "noise"):
            (self._folder / f"{job.run_id}.{suffix}").unlink(missing_ok=True)


def _source(job: CellJob, sources: dict[str, Path]) -> Path:
    """The file behind the QPs of a job."""
    return sources[source_key(job.cell, HARNESS_VERSION)]
