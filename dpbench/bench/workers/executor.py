"""Run cells in processes of their own, have them judged, and keep what is finished.

Closed-loop cells and random sequences run side by side on the cores; replays that are timed run
one worker at a time.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.judge.closed_loop import Evaluated
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, OUTCOMES, Cell, Outcome
from dpbench.bench.record.npz import DAMAGE
from dpbench.bench.record.raw_log import discard
from dpbench.bench.record.result_folder import write_json
from dpbench.bench.sequences.source import log_size, source_key
from dpbench.bench.workers.batch import GRADING_LIMIT_S, CellBatch, configuration_of, not_evaluated
from dpbench.bench.workers.child import Child, in_slots, with_log
from dpbench.bench.workers.interleaved import ReplayGroup
from dpbench.bench.workers.scratch import NoRoomError, Scratch
from dpbench.bench.workers.worker import BatchCell, evaluate_cell, make_source, run_closed_loop_cell
from dpbench.errors import InputError
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
            found = json.loads(text)
            with_steps = found.pop("with_steps")
            outcome = Outcome(**found)
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
        found = outcome.__dict__ | {"with_steps": with_steps}
        write_json(self.folder / f"{job.run_id}.json", found)

    def evaluated(self, job: CellJob) -> Evaluated | None:
        """The judged columns of a cell, None if it left no steps, or they are damaged."""
        try:
            return Evaluated.load(self.evaluated_path(job))
        except (*DAMAGE, OSError, KeyError):
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
    """Runs cells in processes of their own and has them judged."""

    def __init__(
        self,
        context: ForkServerContext,
        scratch: Scratch,
        store: CellStore,
        cores: list[int],
        progress: Progress,
    ) -> None:
        self._context, self._scratch, self._store = context, scratch, store
        self._cores, self._progress = cores, progress
        self._folder = store.folder  # that of the logs at hand, see `_room_for`

    def source(self, cell: Cell, path: Path) -> Outcome:
        """Make the file behind a cell's QPs at `path`: an exactly solved loop, certified optima."""
        name = f"exact-{path.stem}"
        folder = self._scratch.folder()
        args = (cell.to_json(), folder, name, self._cores[-1], path)
        child = Child(self._context, make_source, args, folder, name, limit_s=GRADING_LIMIT_S)
        return child.outcome()

    def _slots(self, count: int) -> list[int]:
        """The core of each of so many slots."""
        return [self._cores[i % len(self._cores)] for i in range(count)]

    def _room_for(self, jobs: Sequence[CellJob], sizes: Sequence[int], what: str) -> bool:
        """Choose where the logs of `jobs` lie; without room for `sizes` [B] they are lost."""
        try:
            self._folder = self._scratch.folder(sum(sizes), what)
        except NoRoomError as error:
            for job in jobs:
                self._lose(job, str(error))
            return False
        return True

    def _sized(
        self, jobs: Sequence[CellJob], sources: dict[str, Path]
    ) -> tuple[list[CellJob], dict[str, int]]:
        """The jobs whose source can be read, and what each of their logs takes [B]."""
        sound, sizes = [], {}
        for job in jobs:
            try:
                path = sources[source_key(job.cell, HARNESS_VERSION)]
                sizes[job.run_id] = log_size(job.cell, path)
            except InputError as error:
                self._lose(job, str(error))
                continue
            sound.append(job)
        return sound, sizes

    def _lose(self, job: CellJob, cause: str) -> None:
        self._store.finish(job, Outcome("lost", cause))
        self._progress.advance(work_of(job.cell), "lost")

    def closed_loops(self, jobs: Sequence[CellJob], exact: dict[str, Path], slots: int) -> None:
        """Run closed-loop cells on up to `slots` cores, each judged right after it ran."""
        jobs, sizes = self._sized(jobs, exact)
        if not jobs or not self._room_for(jobs, sorted(sizes.values())[-slots:], "closed loops"):
            return

        def ended(job: CellJob, child: Child, core: int) -> Child | None:
            if job.outcome is None:
                job.outcome = with_log(child.outcome(), child.raw_path)
                if job.outcome.outcome != "lost" and child.raw_path.exists():
                    return self._evaluate(job, exact[source_key(job.cell, HARNESS_VERSION)], core)
            elif not child.has_verdict:
                job.outcome = not_evaluated(child.outcome())
            self._finish(job)
            return None

        in_slots(jobs, self._slots(slots), self._start, ended)

    def _start(self, job: CellJob, core: int) -> Child:
        args = (job.cell.to_json(), self._folder, job.run_id, core)
        limit_s = job.cell.limit_s
        return Child(
            self._context, run_closed_loop_cell, args, self._folder, job.run_id, limit_s=limit_s
        )

    def _evaluate(self, job: CellJob, exact: Path, core: int) -> Child:
        args = (
            job.cell.to_json(),
            self._folder,
            job.run_id,
            core,
            exact,
            self._store.evaluated_path(job),
        )
        return Child(
            self._context,
            evaluate_cell,
            args,
            self._folder,
            job.run_id,
            limit_s=GRADING_LIMIT_S,
            verdict="evaluated.json",
        )

    def _finish(self, job: CellJob) -> None:
        """Keep the outcome of a cell and drop what it left behind."""
        self._put_away(job)
        what = job.cell.scenario_name or job.cell.sequence
        self._progress.advance(work_of(job.cell), f"{job.cell.solver} {what}")

    def _put_away(self, job: CellJob) -> None:
        judged = (self._folder / f"{job.run_id}.evaluated.json").exists()
        outcome = job.outcome or Outcome("lost", "it was not run")
        self._store.finish(job, outcome, judged=judged)
        discard(self._folder / f"{job.run_id}.raw")
        for suffix in ("json", "evaluated.json", "noise"):
            (self._folder / f"{job.run_id}.{suffix}").unlink(missing_ok=True)

    def replays(self, jobs: Sequence[CellJob], exact: Path) -> None:
        """Replay one sequence through all its configurations, interleaved, then judge them all."""
        name = jobs[0].cell.sequence
        jobs, sizes = self._sized(jobs, {source_key(j.cell, HARNESS_VERSION): exact for j in jobs})
        if not jobs or not self._room_for(jobs, [*sizes.values()], f"the replays of {name}"):
            return
        group = ReplayGroup(
            self._context, self._folder, exact, self._cores[-1], [(j.run_id, j.cell) for j in jobs]
        )
        rounds = max(job.cell.rounds for job in jobs)
        share = sum(work_of(job.cell) for job in jobs) // (rounds + 1)
        with _away_from(self._cores[-1]):
            for r in group.run():
                self._progress.advance(share, f"replay {name}, round {r}")
        raws = {job.run_id: self._folder / f"{job.run_id}.raw" for job in jobs}
        for job in jobs:
            job.outcome = with_log(group.outcomes[job.run_id], raws[job.run_id])
        stepped = [j for j in jobs if j.outcome and j.outcome.outcome != "lost"]
        self._evaluate_all([j for j in stepped if raws[j.run_id].exists()], exact)
        for job in jobs:
            self._put_away(job)

    def _evaluate_all(self, jobs: Sequence[CellJob], exact: Path) -> None:
        """Judge what was replayed, on every core some of it."""
        by_id = {job.run_id: job for job in jobs}
        shares = [jobs[i :: len(self._cores)] for i in range(len(self._cores))]
        sources = {source_key(job.cell, HARNESS_VERSION): exact for job in jobs}
        batches = [self._batch(share, sources) for share in shares if share]
        in_slots(batches, self._cores, CellBatch.evaluate, CellBatch.follow)
        for batch in batches:
            for run_id, lost in batch.outcomes.items():
                by_id[run_id].outcome = lost

    def random(self, jobs: Sequence[CellJob], sources: dict[str, Path], slots: int) -> None:
        """Replay random sequences configuration by configuration, up to `slots` configurations at a
        time, and judge them."""
        jobs, sizes = self._sized(jobs, sources)
        configurations: dict[tuple[str, ...], list[CellJob]] = {}
        for job in jobs:
            configurations.setdefault(configuration_of(job.cell), []).append(job)
        # A configuration keeps the logs of all its cells until they are judged.
        needs = sorted(sum(sizes[job.run_id] for job in mine) for mine in configurations.values())
        if not jobs or not self._room_for(jobs, needs[-slots:], "random problems"):
            return
        batches = [(self._batch(mine, sources), mine) for mine in configurations.values()]

        def ended(task: tuple[CellBatch, list[CellJob]], child: Child, core: int) -> Child | None:
            batch, mine = task
            following = batch.follow(child, core)
            if following is None:
                for job in mine:
                    job.outcome = batch.outcomes[job.run_id]
                    self._finish(job)
            return following

        in_slots(batches, self._slots(slots), lambda task, core: task[0].start(core), ended)

    def _batch(self, jobs: Sequence[CellJob], sources: dict[str, Path]) -> CellBatch:
        cells = [
            BatchCell(
                job.run_id,
                job.cell.to_json(),
                sources[source_key(job.cell, HARNESS_VERSION)],
                self._store.evaluated_path(job),
            )
            for job in jobs
        ]
        return CellBatch(self._context, self._folder, cells, jobs[0].cell.limit_s)
