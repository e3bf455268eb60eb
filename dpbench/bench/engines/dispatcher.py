"""Dispatch of cells and files to an engine: order, sources, retries and counting.

Closed loops run first, then timed replays, then problems without a deadline. A source, such as a
reference loop, takes as long as all of its cells together: it is made once, in a batch with others
that are needed next, and is released after its last cell.
"""

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from dpbench.bench.engines.engine import (
    Completed,
    Engine,
    EngineGoneError,
    HandOverError,
    SourceFiles,
)
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.workers.jobs import (
    Batch,
    CellBatch,
    CellJob,
    FileBatch,
    Kind,
    Result,
    Target,
    choose_batch_seconds,
    count_steps,
    cut_into_groups,
    group_by_source,
    make_cell_label,
    split_into_batches,
)
from dpbench.bench.workers.worker import make_source

SOURCE_STEPS = 25_000
"""Steps of the sources that exist at a time, for each slot: some 2 kB each."""
SOURCE_S, SOURCE_STEP_S = 0.005, 0.0001
"""Rates measured for `docs/guide/scale.md`: a source, and a step of it."""
MOST_ATTEMPTS = 3
"""Number of times that a batch is handed over before it is suspected of ending its workers."""
DIED = "every worker that ran it died"


class Dispatcher:
    """Dispatcher of runs to an engine: makes their files of QPs first, retries lost ones."""

    def __init__(self, engine: Engine, sources: SourceFiles, progress: Progress) -> None:
        self._engine, self._sources, self._progress = engine, sources, progress
        self._waiting = deque[CellBatch]()  # none of their sources is asked for
        self._blocked = list[CellBatch]()  # some of their sources are being made
        self._ready, self._in_flight = deque[Batch](), set[Batch]()
        self._isolated = deque[Batch]()  # run once more, with nothing beside them
        self._being_made, self._made, self._remade = set[str](), set[str](), set[str]()
        self._failed: dict[str, Outcome] = {}
        self._open_steps: dict[str, int] = {}  # of the sources that cells of this kind need
        self._retried = set[str]()

    def yield_results_of_jobs(self, jobs: Sequence[CellJob]) -> Iterator[Result]:
        """Do all runs on the engine; yield exactly one result per run."""
        self._uses = Counter(job.source_key for job in jobs)
        # Of all kinds: a source that serves loops is as long as later replays need it.
        self._of_key = group_by_source(jobs)
        for kind, alike in _yield_kinds_and_jobs(jobs):
            self._left = Counter(job.source_key for job in alike)
            self._waiting.extend(split_into_batches(kind, alike, self._engine.slots))
            for batch, results in self._yield_completed_batches():
                if isinstance(batch, CellBatch):
                    yield from self._yield_results_and_requeue_damaged(batch, results)
                else:
                    self._note_made_sources(results)

    def yield_made_files(
        self, target: Target, texts: Mapping[Path, str], *, limit_s: float | None = None
    ) -> Iterator[tuple[Path, Outcome]]:
        """Make files in processes of their own, each within `limit_s`; yield path and outcome."""
        self._ready.extend(FileBatch(target, {path: text}, limit_s) for path, text in texts.items())
        for _, results in self._yield_completed_batches():
            for result in results:
                yield Path(result.run_id), result.outcome

    def _yield_completed_batches(self) -> Iterator[Completed]:
        """Do all queued batches of runs on the engine; yield each with its final results."""
        while True:
            try:
                self._queue_making_of_sources()
                yield from self._queue_unblocked_and_yield_failed()
                self._submit_queued_batches()
                if not (self._in_flight or self._waiting or self._blocked or self._isolated):
                    return
                for batch, results in (
                    self._engine.yield_completed_batches() if self._in_flight else ()
                ):
                    self._in_flight.remove(batch)
                    yield batch, [*results, *self._requeue_or_lose_unanswered(batch, results)]
            except HandOverError:
                yield from self._requeue_dropped_batches()
            except EngineGoneError as error:
                yield from self._yield_lost_for_all_unfinished(str(error))

    def _queue_making_of_sources(self) -> None:
        """Queue the making of the files of QPs that the next batches of runs need."""
        idle = not (self._ready or self._in_flight)
        if self._isolated and idle:
            batch = self._isolated.popleft()
            if isinstance(batch, CellBatch):
                self._waiting.appendleft(batch)
            else:
                self._ready.append(batch)
                return
        # Where times are taken no source is made beside them.
        if not self._waiting or (self._waiting[0].is_timed and not idle):
            return
        limit, keys = SOURCE_STEPS * self._engine.slots, list[str]()
        while self._waiting:
            known = self._made | self._being_made | self._failed.keys()
            new = [key for key in self._waiting[0].source_keys if key not in known]
            others = self._ready or self._in_flight or self._blocked
            if new and others and sum(self._open_steps.values()) >= limit:
                break
            self._blocked.append(self._waiting.popleft())
            self._being_made.update(new)
            self._open_steps |= {
                key: find_cell_with_most_steps(self._of_key[key]).steps_needed_in_file
                for key in new
            }
            keys += new
        self._ready.extend(self._yield_source_batches(keys))

    def _yield_source_batches(self, keys: Sequence[str]) -> Iterator[FileBatch]:
        """Yield batches that make files of QPs, each as long as the longest run that uses it."""
        seconds = {key: SOURCE_S + SOURCE_STEP_S * self._open_steps[key] for key in keys}
        size_s = choose_batch_seconds(sum(seconds.values()), self._engine.slots)
        for group in cut_into_groups(keys, seconds.__getitem__, size_s):
            cells = {
                self._sources.path(key): find_cell_with_most_steps(self._of_key[key])
                for key in group
            }
            texts = {path: cell.to_json() for path, cell in cells.items()}
            yield FileBatch(make_source, texts, are_sources=True)

    def _queue_unblocked_and_yield_failed(self) -> Iterator[Completed]:
        """Queue batches whose QP files are made; yield results of runs whose QP file failed."""
        blocked, self._blocked = self._blocked, []
        for batch in blocked:
            if not self._being_made.isdisjoint(batch.source_keys):
                self._blocked.append(batch)
                continue
            failed = [job for job in batch.jobs if job.source_key in self._failed]
            if failed:
                results = [
                    _make_sourceless_result(job, self._failed[job.source_key]) for job in failed
                ]
                yield CellBatch(batch.kind, failed), results
            batch.jobs = [job for job in batch.jobs if job.source_key not in self._failed]
            if batch.jobs:
                self._ready.append(batch)

    def _submit_queued_batches(self) -> None:
        """Submit queued batches of runs to the engine while they may run at the same time."""
        while self._ready and self._can_run_beside_submitted(self._ready[0]):
            self._engine.submit(self._ready[0])
            self._in_flight.add(self._ready.popleft())

    def _can_run_beside_submitted(self, batch: Batch) -> bool:
        """Return whether a batch of runs may run beside those the engine already has."""
        if not self._in_flight:
            return True
        other = next(iter(self._in_flight))
        room = len(self._in_flight) < self._engine.count_batches_to_submit(timed=batch.is_timed)
        return room and batch.is_timed == other.is_timed and not (batch.isolated or other.isolated)

    def _note_made_sources(self, results: Sequence[Result]) -> None:
        """Store for each file of QPs whether the engine made it or why it failed."""
        keys = {str(self._sources.path(key)): key for key in self._being_made}
        for result in results:
            key = keys[result.run_id]
            self._being_made.remove(key)
            if result.outcome.outcome == "finished":
                self._made.add(key)
            else:
                self._failed[key] = result.outcome

    def _yield_results_and_requeue_damaged(
        self, batch: CellBatch, results: Sequence[Result]
    ) -> Iterator[Result]:
        """Yield a batch's results; runs lost with a damaged file of QPs are queued again."""
        jobs = {job.run_id: job for job in batch.jobs}
        lost = [jobs[one.run_id] for one in results if one.outcome.outcome == "lost"]
        again = {job.run_id: job for job in lost if self._has_damaged_source(job)}
        if again:
            self._retried |= again.keys()
            damaged = {job.source_key for job in again.values()} & self._made
            self._made -= damaged
            self._remade |= damaged
            self._waiting.appendleft(CellBatch(batch.kind, [*again.values()]))
        for result in results:
            if result.run_id not in again:
                self._advance_progress_and_release_source(batch, jobs[result.run_id])
                yield result

    def _has_damaged_source(self, job: CellJob) -> bool:
        """Return whether a lost run's file of QPs was damaged since it was made."""
        key = job.source_key
        if job.run_id in self._retried or key in self._failed:
            return False
        return key in self._remade or not self._engine.is_qp_file_intact(
            key, find_cell_with_most_steps(self._of_key[key])
        )

    def _advance_progress_and_release_source(self, batch: CellBatch, job: CellJob) -> None:
        """Advance the progress by a finished run; release its QP file after its last user."""
        shown = min(batch.shown_work, count_steps(job.cell))
        batch.shown_work -= shown
        self._progress.advance(count_steps(job.cell) - shown, make_cell_label(job.cell))
        key = job.source_key
        self._left[key] -= 1
        self._uses[key] -= 1
        if not self._left[key]:
            self._open_steps.pop(key, None)
        if not self._uses[key]:
            self._made.discard(key)
            self._engine.release_source(key)

    def _requeue_or_lose_unanswered(self, batch: Batch, results: Sequence[Result]) -> list[Result]:
        """Queue runs without a result for a retry alone; after it return a "lost" for each."""
        names = set(batch.names) - {result.run_id for result in results}
        if batch.isolated:
            return [Result(name, Outcome("lost", DIED)) for name in names]
        self._isolated.extend(batch.split_for_isolated_retry(names))
        return []

    def _requeue_dropped_batches(self) -> Iterator[Completed]:
        """Queue again all batches that the engine dropped; retry alone those dropped too often."""
        dropped, self._in_flight = self._in_flight, set()
        self._made.clear()
        ready, self._ready = self._ready, deque()
        for batch in dropped:
            batch.attempts += 1
            if batch.attempts == MOST_ATTEMPTS:
                yield batch, self._requeue_or_lose_unanswered(batch, [])
        ready.extendleft(batch for batch in dropped if batch.attempts < MOST_ATTEMPTS)
        self._waiting.extendleft(self._blocked)
        self._blocked.clear()
        for batch in ready:
            if isinstance(batch, CellBatch):
                self._waiting.appendleft(batch)
            else:
                self._ready.append(batch)

    def _yield_lost_for_all_unfinished(self, reason: str) -> Iterator[Completed]:
        """Empty all queues; yield a "lost" result for every run or file without one."""
        cells = [*self._blocked, *self._waiting]
        batches = [*cells, *self._in_flight, *self._ready, *self._isolated]
        for queue in (self._blocked, self._waiting, self._ready, self._isolated):
            queue.clear()
        self._in_flight.clear()
        self._being_made.clear()
        self._made.clear()
        for batch in batches:
            if isinstance(batch, CellBatch) or not batch.are_sources:
                yield batch, [Result(name, Outcome("lost", reason)) for name in batch.names]


def find_cell_with_most_steps(jobs: Sequence[CellJob]) -> Cell:
    """Return that of the runs on one file of QPs which needs the most steps of it."""
    return max((job.cell for job in jobs), key=lambda cell: cell.steps_needed_in_file)


def _yield_kinds_and_jobs(jobs: Sequence[CellJob]) -> Iterator[tuple[Kind, list[CellJob]]]:
    """Yield kind and runs: closed loops, then timed replays, then problems without a deadline."""
    replays = [job for job in jobs if job.cell.mode == "replay"]
    yield "closed loops", [job for job in jobs if job.cell.mode == "closed_loop"]
    yield "replays", [job for job in replays if job.cell.is_timed]
    yield "problems without a deadline", [job for job in replays if not job.cell.is_timed]


def _make_sourceless_result(job: CellJob, outcome: Outcome) -> Result:
    """Return the result of a run whose QPs could not be made: "lost" or "invalid", and why."""
    what = "reference loop" if job.cell.scenario else "sequence"
    became = "lost" if outcome.outcome == "lost" else "invalid"
    return Result(job.run_id, Outcome(became, f"the {what} failed: {outcome.detail}"))
