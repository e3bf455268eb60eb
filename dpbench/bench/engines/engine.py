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
    """The engine dropped all batches and sources, which are to be handed over again."""


class EngineGoneError(DpbenchError):
    """The engine runs nothing any more."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Runs batches; all that it starts ends with the `with` block.

    Of a result folder it writes only the files that it is asked to make.

    Attributes
    ----------
    machine : the machine of the cells, as `describe_machine` describes it; of several the one that
        times replays.
    """

    machine: MachineDescription

    @property
    def slots(self) -> int:
        """Batches that run at a time."""

    @property
    def remarks(self) -> Sequence[str]:
        """Lines for the end of the campaign."""

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Get ready to run cells."""

    def capacity(self, *, timed: bool) -> int:
        """Return how many batches to hand over at a time: of timed replays, or of others."""

    def submit(self, batch: Batch) -> None:
        """Take a batch with existing sources."""

    def completed(self) -> Iterator[Completed]:
        """Wait until batches are completed, or for some seconds, and yield them.

        Raises
        ------
        HandOverError, EngineGoneError : also of `submit`.
        """

    def has_source(self, key: str, cell: Cell) -> bool:
        """Check that a source is still whole, for a cell that was lost with it."""

    def release_source(self, key: str) -> None:
        """Release a source that no cell needs any more."""
