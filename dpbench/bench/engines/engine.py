"""The protocol of an engine: it takes batches and files of QPs, and hands back results."""

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.result_folder import MachineDescription
from dpbench.bench.workers.jobs import Batch, CellJob, Result
from dpbench.errors import DpbenchError

BATCHES_AHEAD = 2
"""Batches handed over at a time for each slot, so that no slot waits for the campaign."""
TlsFiles = Sequence[str | Path]
"""Files of a cluster with TLS, in PEM format: its certificate authority, a client's certificate,
its key."""
Completed = tuple[Batch, Sequence[Result]]
"""A batch and the results of its cells or files. One without a result took its process along."""


_SOURCE = re.compile(r"exact-(?P<key>\w+)(?:\.part)*\.npz")


class SourceFiles:
    """The files of QPs of one campaign, which its workers read; those in `kept` stay at its end."""

    def __init__(self, folder: Path, kept: Collection[str] = ()) -> None:
        self.folder, self._kept = folder, set(kept)

    def path(self, key: str) -> Path:
        """Return the path of the file of QPs with this hash key."""
        return self.folder / f"exact-{key}.npz"

    def remove(self, key: str) -> None:
        """Delete the file of QPs with this key, unless it is to be kept."""
        if key not in self._kept:
            self.path(key).unlink(missing_ok=True)

    def clear(self) -> None:
        """Delete all files of QPs but those to be kept, also those of an interrupted campaign."""
        for path in self.folder.iterdir():
            own = _SOURCE.fullmatch(path.name)
            if own and own["key"] not in self._kept:
                path.unlink(missing_ok=True)


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
        """Number of batches of runs that the engine does at a time."""

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks of the engine to show the user at the end of the campaign."""

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Start the processes or workers needed for the runs `jobs`."""

    def count_batches_to_submit(self, *, timed: bool) -> int:
        """Return how many batches of runs to submit ahead: of timed replays, or of others."""

    def submit(self, batch: Batch) -> None:
        """Start or queue a batch of runs, whose files of QPs must exist."""

    def yield_completed_batches(self) -> Iterator[Completed]:
        """Wait some seconds for completed batches of runs; yield each with its results.

        HandOverError or EngineGoneError, also of `submit`, where the batches are lost.
        """

    def is_qp_file_intact(self, key: str, cell: Cell) -> bool:
        """Return whether a file of QPs is still intact, after a run that needs it was lost."""

    def release_source(self, key: str) -> None:
        """Delete a file of QPs that no run needs any more."""
