"""The protocol of an engine: it takes batches, and hands back their results."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from dpbench.bench.engines.sources import SourceFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.result_folder import MachineDescription
from dpbench.bench.workers.jobs import Batch, CellJob, Result
from dpbench.errors import DpbenchError

BATCHES_AHEAD = 2
"""Batches handed over at a time for each slot, so that no slot waits for the campaign."""
TlsFiles = Sequence[str | Path]
"""Of a cluster with TLS, in PEM format: its certificate authority, a client's certificate, its
key."""
Completed = tuple[Batch, Sequence[Result]]
"""A batch and the results of its cells or files. One without a result took its process along."""


class HandOverError(DpbenchError):
    """Raised when an engine has dropped all its batches of runs; they must be submitted again."""


class EngineGoneError(DpbenchError):
    """Raised when an engine, such as a cluster, cannot run anything any more."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Protocol of what does batches of runs: this machine's processes, or a cluster's workers.

    Of a result folder it writes only the files that it is asked to make. `machine` is that of the
    cells; of several the one that times replays.
    """

    machine: MachineDescription

    @property
    def slots(self) -> int:
        """Number of batches of runs that are done at a time."""

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks to show at the end of the campaign."""

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Start the processes or workers needed for the runs `jobs`."""

    def capacity(self, *, timed: bool) -> int:
        """Return how many batches of runs to submit ahead: of timed replays, or of others."""

    def submit(self, batch: Batch) -> None:
        """Start or queue a batch of runs, whose files of QPs must exist."""

    def completed(self) -> Iterator[Completed]:
        """Wait some seconds for completed batches of runs; yield each with its results.

        HandOverError or EngineGoneError, also of `submit`, where the batches are lost.
        """

    def has_source(self, key: str, cell: Cell) -> bool:
        """Return whether a file of QPs is still intact, after a run that needs it was lost."""

    def release_source(self, key: str) -> None:
        """Delete a file of QPs that no run needs any more."""
