"""The engine of a cluster: batches of cells, and the sources of their QPs, as tasks of Dask.

A source is made on a worker and stays there: Dask hands its bytes to the workers whose cells need
it, and makes it again where it was lost with its worker. Files of the campaign's machine, such as
recorded sequences, are sent instead. Few more tasks than slots are submitted at a time: a batch
that kills its worker takes few others along, and no scheduler holds a whole campaign.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from distributed import CancelledError, Future, KilledWorker

from dpbench.bench.engines import on_worker
from dpbench.bench.engines.dask_cluster import (
    EXCLUSIVE,
    Cluster,
    StepEvents,
    connect_client,
    start_own_cluster,
)
from dpbench.bench.engines.engine import (
    BATCHES_AHEAD,
    Completed,
    EngineGoneError,
    HandOverError,
    SourceFiles,
    TlsFiles,
)
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell, Outcome, RecordedSource
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.sequences.source import is_readable
from dpbench.bench.workers.jobs import Batch, CellBatch, CellJob, FileBatch, Result
from dpbench.files.regular_files import write_bytes_atomically

RETRIES = 2
"""Number of times that a task is run again after an error of the harness."""
REFRESH_S = 5.0
"""Interval between looks at the workers, which come and go [s]."""
NOT_ALONE = (
    f"no worker offers the resource {EXCLUSIVE!r}: replays run in parallel with others, so their "
    "times are not ranked"
)


def open_dask_engine(
    scheduler: str | None, workers: int, tls: TlsFiles | None = None
) -> "DaskEngine":
    """Return an engine on a Dask scheduler's workers, or on `workers` new ones on this machine."""
    engine = DaskEngine(workers)
    with ExitStack() as until_connected:
        until_connected.push(engine)
        if scheduler is not None:
            engine.connect_to_scheduler(scheduler, tls)
        until_connected.pop_all()
    return engine


class DaskEngine(ExitStack):
    """An engine that does batches of runs as tasks on the workers of a Dask cluster."""

    def __init__(self, workers: int) -> None:
        super().__init__()
        self.machine = describe_machine()
        self.remarks: list[str] = []
        self._workers, self._where = workers, "on this machine"
        self._cluster: Cluster | None = None
        token = uuid4().hex[:8]
        # Two campaigns may ask one scheduler for the same.
        self._names = (f"{i}-{token}" for i in count())
        self._drop_tasks_and_sources()

    def _drop_tasks_and_sources(self) -> None:
        """Empty the records of submitted tasks and of files of QPs made on Dask workers."""
        self._in_flight: dict[str, Batch] = {}
        self._sources: dict[str, Future] = {}  # by the path of their file
        self._given_to: dict[str, frozenset[str]] = {}  # the workers that each task may run on
        self._ended = SimpleQueue[Future]()

    def connect_to_scheduler(self, scheduler: str, tls: TlsFiles | None) -> None:
        """Connect to the workers of a Dask scheduler; InputError where that is impossible."""
        client = self.enter_context(connect_client(scheduler, tls))
        self._where = f"at {scheduler}"
        self._cluster = Cluster(client)
        self.machine = self._cluster.machine

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Start Dask workers unless connected to some; remark on limits of their timing."""
        self._files, self._progress = sources, progress
        modules = {job.cell.solver_module for job in jobs} - {""}
        texts = {path: Path(path).read_text(encoding="utf-8") for path in modules}
        steps = StepEvents(f"dpbench-steps-{next(self._names)}")
        self._context = on_worker.CampaignContext(modules=texts, progress=steps)
        if self._cluster is None:
            client = self.enter_context(start_own_cluster(self._workers))
            self._cluster = Cluster(client, is_own=True)
        self._cluster.client.subscribe_topic(steps.topic, self._show_step)
        if (kinds := self._cluster.kinds) > 1:
            progress.remark(
                f"workers on {kinds} kinds of machines: only replays of one kind are ranked"
            )
        if not self._cluster.exclusive and any(job.cell.is_timed for job in jobs):
            progress.remark(NOT_ALONE)
        self._refreshed_s = time.monotonic()

    def _show_step(self, event: tuple[float, str]) -> None:
        """Show the step of a reference loop that a Dask worker reports."""
        self._progress.advance(0, event[1])

    @property
    def slots(self) -> int:
        """Number of batches of runs that the Dask workers do at a time."""
        return self.cluster.slots

    @property
    def cluster(self) -> Cluster:
        """The Dask cluster that does the runs."""
        assert self._cluster is not None, "it is prepared"
        return self._cluster

    def count_batches_to_submit(self, *, timed: bool) -> int:
        """Return how many batches of runs to submit ahead, enough for all Dask workers."""
        return BATCHES_AHEAD * self.slots

    def submit(self, batch: Batch) -> None:
        """Submit a batch of runs or files as a task to the Dask scheduler."""
        if isinstance(batch, CellBatch):
            future = self._submit_cells(batch)
        elif batch.are_sources:
            future = self._submit_making_of_sources(batch)
        else:
            future = self._submit_making_of_files(batch, batch.texts)
        self._in_flight[future.key] = batch
        self._given_to[future.key] = self.cluster.addresses
        future.add_done_callback(self._ended.put)

    def yield_completed_batches(self) -> Iterator[Completed]:
        """Wait some seconds for a completed batch of runs; yield it with its results."""
        if time.monotonic() - self._refreshed_s >= REFRESH_S:
            self._update_workers_or_hand_over()
        try:
            future = self._ended.get(timeout=REFRESH_S)
        except Empty:
            return
        batch = self._in_flight.pop(future.key)
        self._given_to.pop(future.key, None)
        yield batch, self._read_results(batch, future)

    def is_qp_file_intact(self, key: str, cell: Cell) -> bool:
        """Return True: Dask remakes a file of QPs that was lost with its worker."""
        return True

    def release_source(self, key: str) -> None:
        """Let Dask free the memory of a file of QPs on its workers."""
        if source := self._sources.pop(str(self._files.path(key)), None):
            self._given_to.pop(source.key, None)

    def _update_workers_or_hand_over(self) -> None:
        """Update the list of workers; HandOverError if all workers of some task are gone."""
        for remark in self.cluster.update_workers():
            self._progress.remark(remark)
        self._refreshed_s = time.monotonic()
        if self.cluster.is_own:
            return
        if any(map(self.cluster.addresses.isdisjoint, self._given_to.values())):
            self.cluster.client.cancel([*self._sources.values()])
            self._drop_tasks_and_sources()
            raise HandOverError("every worker that was given a task has left")

    def _read_results(self, batch: Batch, future: Future) -> Sequence[Result]:
        """Return the run results of a completed Dask task; none where its workers died."""
        try:
            returned = future.result()
        except CancelledError as error:
            # Nobody else lets a task go: it went with the connection, and all others did.
            raise self._choose_error_after_waiting() from error
        except KilledWorker:
            return []
        except Exception as error:  # kept in the rows of its cells; others go on
            failed = f"its worker failed: {type(error).__name__}: {error}"[:300]
            return [Result(name, Outcome("lost", failed)) for name in batch.names]
        if isinstance(batch, CellBatch) or batch.are_sources:
            results: Sequence[Result] = returned
            return results
        for name, made in returned.items():
            if made.data:
                write_bytes_atomically(Path(name), made.data)
        return on_worker.list_outcomes_as_results(returned)

    def _choose_error_after_waiting(self) -> HandOverError | EngineGoneError:
        """Wait for a lost Dask scheduler; return the error to raise: submit again, or give up."""
        self._drop_tasks_and_sources()
        if not self.cluster.wait_for_reconnection():
            return EngineGoneError(f"the connection to the scheduler {self._where} was lost")
        self._update_workers_or_hand_over()
        return HandOverError("the connection was lost for a while")

    def _submit_cells(self, batch: CellBatch) -> Future:
        """Submit a batch of runs and the files of their QPs as a Dask task; return its future."""
        alone = batch.is_timed and self.cluster.exclusive
        return self._submit_call(
            on_worker.run_cells,
            self._context,
            batch,
            {key: self._sources[str(self._files.path(key))] for key in batch.source_keys},
            alone=alone,
            # What else runs on a machine that nobody has given over is not known.
            concurrency=1 if alone else max(2, self.cluster.concurrency),
            resources={EXCLUSIVE: 1} if alone else None,
            name=batch.kind.replace(" ", "_"),
            retries=RETRIES,
        )

    def _submit_making_of_sources(self, batch: FileBatch) -> Future:
        """Submit Dask tasks that make and keep files of QPs; return their outcomes' future."""
        made: dict[str, Future] = {}
        texts = dict(batch.texts)
        for path, text in batch.texts.items():
            cell = Cell.from_json(text)
            if isinstance(cell.source, RecordedSource) or is_readable(cell, path):
                found = on_worker.read_or_make_source(cell, path)
                made[str(path)] = self._submit_call(
                    on_worker.return_file_unchanged, found, name="source"
                )
                del texts[path]
        if texts:
            together = self._submit_making_of_files(batch, texts)
            for name in map(str, texts):
                made[name] = self._submit_call(dict.get, together, name, name="source")
        self._sources |= made
        self._given_to |= {future.key: self.cluster.addresses for future in made.values()}
        return self._submit_call(on_worker.list_outcomes_as_results, made, name="made")

    def _submit_making_of_files(self, batch: FileBatch, texts: Mapping[Path, str]) -> Future:
        """Submit a Dask task that makes a batch of files from texts; return its future."""
        named = {str(path): text for path, text in texts.items()}
        args = on_worker.make_files, self._context, batch.target, named, batch.limit_s
        name = batch.target.__name__
        return self._submit_call(*args, isolated=batch.isolated, name=name, retries=RETRIES)

    def _submit_call(
        self, function: Callable[..., Any], *args: Any, name: str, **how: Any
    ) -> Future:
        """Submit a function call as a uniquely named task to Dask workers; return its future."""
        if self.cluster.client.status != "running":
            raise self._choose_error_after_waiting()
        key = f"{name}-{next(self._names)}"
        if not self.cluster.is_own:
            how["workers"] = [*self.cluster.addresses]
        return self.cluster.client.submit(function, *args, key=key, pure=False, **how)
