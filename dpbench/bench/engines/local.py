"""The engine of one machine: processes on its cores, sources in files beside the results."""

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack

from dpbench.bench.engines.engine import BATCHES_AHEAD, Completed, SourceFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.sequences.source import is_readable
from dpbench.bench.workers.child import has_compiled_kernels, start_forkserver
from dpbench.bench.workers.executor import CellExecutor
from dpbench.bench.workers.jobs import Batch, CellBatch, CellJob
from dpbench.bench.workers.scratch import Scratch
from dpbench.locks import WaitLimit

COMPILING = "compiling the kernels, once after an installation: up to a minute"


class LocalEngine(ExitStack):
    """Engine that does runs in `slots` processes on this machine; timed replays one at a time."""

    def __init__(self, slots: int, patience: WaitLimit = WaitLimit()) -> None:  # noqa: B008 - frozen
        super().__init__()
        self.machine = describe_machine()
        self.slots, self._patience = slots, patience

    @property
    def remarks(self) -> list[str]:
        """Remarks on raw logs of runs that had no room in the usual folder."""
        return self._scratch.remarks

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Start the server that forks processes, open temporary folders, check machine load."""
        if not has_compiled_kernels():
            progress.remark(COMPILING)
        self._sources = sources
        self._scratch = self.enter_context(Scratch(sources.folder))
        executor = CellExecutor(
            start_forkserver(),
            self._scratch,
            sorted(os.sched_getaffinity(0)),
            self.slots,
            progress,
            self.machine["id"],
            work=str(sources.folder.parent),
            patience=self._patience,
        )
        self._executor = self.enter_context(executor)
        if jobs:
            executor.check_machine_free(times=any(job.cell.is_timed for job in jobs))

    def count_batches_to_submit(self, *, timed: bool) -> int:
        """Return how many batches of runs to submit ahead: one if timed, else two per process."""
        return 1 if timed else BATCHES_AHEAD * self.slots

    def submit(self, batch: Batch) -> None:
        """Start or queue a batch of runs on the cores of this machine."""
        keys = batch.source_keys if isinstance(batch, CellBatch) else []
        self._executor.submit(batch, {key: self._sources.path(key) for key in keys})

    def yield_completed_batches(self) -> Iterator[Completed]:
        """Wait for completed batches of runs; yield each with its results."""
        return self._executor.wait_for_batches()

    def is_source_intact(self, key: str, cell: Cell) -> bool:
        """Return whether the file of a run's QPs can be read to its end."""
        return is_readable(cell, self._sources.path(key))

    def release_source(self, key: str) -> None:
        """Delete a file of QPs that no run needs any more."""
        self._sources.remove(key)
