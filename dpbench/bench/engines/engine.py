"""The protocol of an engine: it takes batches, and hands back their results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from dpbench.bench.engines.sources import SourceFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.descriptions import MachineDescription
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
    """The engine dropped all batches and sources that it had; they are to be handed over again."""


class EngineGoneError(DpbenchError):
    """The engine runs nothing any more."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Runs batches; whatever it has started ends with the `with` block.

    It writes nothing into a result folder but the files that it is asked to make.

    Attributes
    ----------
    machine : the machine that cells run on, as `describe_machine` describes it; of several the one
        that times replays.
    slots : batches that run at a time.
    remarks : lines for whoever started the campaign, at its end.
    """

    machine: MachineDescription

    @property
    def slots(self) -> int: ...

    @property
    def remarks(self) -> Sequence[str]: ...

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Get ready to run cells.

        Parameters
        ----------
        sources : where the files behind QPs lie on the machine of the campaign.
        progress : of the campaign.
        """

    def capacity(self, *, timed: bool) -> int:
        """Return how many batches to hand over at a time: of timed replays, or of all else."""

    def submit(self, batch: Batch) -> None:
        """Take a batch, whose sources were made before."""

    def completed(self) -> Iterator[Completed]:
        """Wait until batches are completed, or for some seconds, and yield them.

        Raises
        ------
        HandOverError, EngineGoneError : also of `submit`.
        """

    def has_source(self, key: str, cell: Cell) -> bool:
        """Check that a source that was made is still whole, for a cell that was lost with it."""

    def release_source(self, key: str) -> None:
        """Let go of a source that no cell needs any more."""
