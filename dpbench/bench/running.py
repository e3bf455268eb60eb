"""Run cells in processes of their own, have them judged, and keep what is finished.

Closed-loop cells and random sequences run side by side on the cores; replays that are timed run
one worker at a time.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Protocol

from dpbench.bench.cell import Cell
from dpbench.bench.chain import GRADING_LIMIT_S, Chain, arm_of
from dpbench.bench.grade import Graded
from dpbench.bench.interleave import ReplayGroup
from dpbench.bench.planned import Planned
from dpbench.bench.rawlog import discard
from dpbench.bench.source import source_key
from dpbench.bench.store import write_json
from dpbench.bench.supervise import Child, Outcome, in_slots
from dpbench.bench.worker import Link, grade_cell, make_source, run_closed_loop_cell
from dpbench.solvers.table import Availability

HARNESS_VERSION = version("dpbench")


class Progress(Protocol):
    """Who is told how far a campaign is; `work` is in steps."""

    def start(self, work: int) -> None:
        """So much is to be done."""

    def advance(self, work: int, what: str) -> None:
        """So much is done now, the last of it on `what`."""


class Silent:
    """A progress that shows nothing."""

    def start(self, work: int) -> None:
        """Show nothing."""

    def advance(self, work: int, what: str) -> None:
        """Show nothing."""


@dataclass(eq=False)
class Job:
    """A planned cell on its way through the campaign."""

    planned: Planned
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

    def graded_path(self, job: Job) -> Path:
        """Where the judged columns of a cell go."""
        return self.folder / f"{job.run_id}.npz"

    def finished(self, job: Job) -> Outcome | None:
        """The outcome of a cell that was finished earlier, None if there is none."""
        path = self.folder / f"{job.run_id}.json"
        if not path.exists():
            return None
        try:
            return Outcome(**json.loads(path.read_text(encoding="utf-8")))
        except (ValueError, TypeError):
            return None

    def finish(self, job: Job, outcome: Outcome) -> None:
        """Keep a cell's outcome; its columns were written before."""
        job.outcome = outcome
        write_json(self.folder / f"{job.run_id}.json", outcome.__dict__)

    def graded(self, job: Job) -> Graded | None:
        """The judged columns of a cell, None if it left no steps."""
        path = self.graded_path(job)
        return Graded.load(path) if path.exists() else None


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
        folder: Path,
        store: CellStore,
        cores: list[int],
        progress: Progress,
    ) -> None:
        self._context, self._folder, self._store = context, folder, store
        self._cores, self._progress = cores, progress

    def source(self, cell: Cell, path: Path) -> Outcome:
        """Make the file behind a cell's QPs at `path`: an exactly solved loop, certified optima."""
        name = f"exact-{path.stem}"
        args = (cell.to_json(), self._folder, name, self._cores[-1])
        child = Child(self._context, make_source, args, self._folder, name, limit_s=GRADING_LIMIT_S)
        outcome = child.outcome()
        if outcome.outcome == "finished":
            (path.with_suffix(".part")).write_bytes((self._folder / f"{name}.npz").read_bytes())
            path.with_suffix(".part").replace(path)
        return outcome

    def _slots(self, count: int) -> list[int]:
        """The core of each of so many slots."""
        return [self._cores[i % len(self._cores)] for i in range(count)]

    def closed_loops(self, jobs: Sequence[Job], exact: dict[str, Path], slots: int) -> None:
        """Run closed-loop cells on up to `slots` cores, each judged right after it ran."""

        def ended(job: Job, child: Child, core: int) -> Child | None:
            if job.outcome is None:
                job.outcome = child.outcome()
                if child.raw_path.exists():
                    return self._grade(job, exact[source_key(job.cell, HARNESS_VERSION)], core)
            self._finish(job)
            return None

        in_slots(jobs, self._slots(slots), self._start, ended)

    def _start(self, job: Job, core: int) -> Child:
        args = (job.cell.to_json(), self._folder, job.run_id, core)
        limit_s = job.cell.limit_s
        return Child(
            self._context, run_closed_loop_cell, args, self._folder, job.run_id, limit_s=limit_s
        )

    def _grade(self, job: Job, exact: Path, core: int) -> Child:
        args = (
            job.cell.to_json(),
            self._folder,
            job.run_id,
            core,
            exact,
            self._store.graded_path(job),
        )
        return Child(
            self._context,
            grade_cell,
            args,
            self._folder,
            job.run_id,
            limit_s=GRADING_LIMIT_S,
            verdict="graded.json",
        )

    def _finish(self, job: Job) -> None:
        """Keep the outcome of a cell and drop its raw log."""
        assert job.outcome is not None, "a cell is finished after its process ended"
        outcome = job.outcome
        verdict = self._folder / f"{job.run_id}.graded.json"
        raw = self._folder / f"{job.run_id}.raw"
        if raw.exists() and not verdict.exists():
            outcome = replace(
                outcome, outcome="invalid", detail=f"the referee failed on it; {outcome.detail}"
            )
        self._store.finish(job, outcome)
        discard(raw)
        what = job.cell.scenario_name or job.cell.sequence
        self._progress.advance(work_of(job.cell), f"{job.cell.solver} {what}")

    def replays(self, jobs: Sequence[Job], exact: Path) -> None:
        """Replay one sequence through all its arms, interleaved, then judge them all."""
        group = ReplayGroup(
            self._context, self._folder, exact, self._cores[-1], [(j.run_id, j.cell) for j in jobs]
        )
        rounds = max(job.cell.rounds for job in jobs)
        share = sum(work_of(job.cell) for job in jobs) // (rounds + 1)
        with _away_from(self._cores[-1]):
            for r in group.run():
                self._progress.advance(share, f"replay {jobs[0].cell.sequence}, round {r}")
        for job in jobs:
            job.outcome = group.outcomes[job.run_id]
        self._judge_all([j for j in jobs if (self._folder / f"{j.run_id}.raw").exists()], exact)
        for job in jobs:
            self._store.finish(job, job.outcome or Outcome("invalid", "not run"))
            discard(self._folder / f"{job.run_id}.raw")

    def _judge_all(self, jobs: Sequence[Job], exact: Path) -> None:
        """Judge what was replayed, on every core some of it."""
        by_id = {job.run_id: job for job in jobs}
        shares = [jobs[i :: len(self._cores)] for i in range(len(self._cores))]
        sources = {source_key(job.cell, HARNESS_VERSION): exact for job in jobs}
        chains = [self._chain(share, sources) for share in shares if share]
        in_slots(chains, self._cores, Chain.judge, Chain.follow)
        for chain in chains:
            for run_id, invalid in chain.outcomes.items():
                by_id[run_id].outcome = invalid

    def random(self, jobs: Sequence[Job], sources: dict[str, Path], slots: int) -> None:
        """Replay random sequences arm by arm, up to `slots` arms at a time, and judge them."""
        arms: dict[tuple[str, ...], list[Job]] = {}
        for job in jobs:
            arms.setdefault(arm_of(job.cell), []).append(job)
        chains = [(self._chain(mine, sources), mine) for mine in arms.values()]

        def ended(task: tuple[Chain, list[Job]], child: Child, core: int) -> Child | None:
            chain, mine = task
            following = chain.follow(child, core)
            if following is None:
                for job in mine:
                    job.outcome = chain.outcomes[job.run_id]
                    self._finish(job)
            return following

        in_slots(chains, self._slots(slots), lambda task, core: task[0].start(core), ended)

    def _chain(self, jobs: Sequence[Job], sources: dict[str, Path]) -> Chain:
        links = [
            Link(
                job.run_id,
                job.cell.to_json(),
                sources[source_key(job.cell, HARNESS_VERSION)],
                self._store.graded_path(job),
            )
            for job in jobs
        ]
        return Chain(self._context, self._folder, links, jobs[0].cell.limit_s)
