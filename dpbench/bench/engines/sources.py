"""The files that QPs are made from, beside the results, each as long as a cell needs it."""

import re
from collections.abc import Collection
from pathlib import Path

from dpbench.bench.engines.on_worker import MadeFile
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.sequences.source import is_readable, source_file
from dpbench.errors import CertificateError, InputError

_SOURCE = re.compile(r"exact-(?P<key>\w+)(?:\.part)*\.npz")


class SourceFiles:
    """The files of QPs of one campaign, which its workers read.

    `kept` are the keys of files that the result folder needs at the end of the campaign.
    """

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


def read_source(cell: Cell, path: Path) -> MadeFile:
    """Return the file of a run's QPs as bytes; make it where it is missing."""
    if not is_readable(cell, path):
        try:
            source_file(cell).make(path)
        except (CertificateError, InputError) as error:
            return MadeFile(Outcome("invalid", str(error)))
    return MadeFile(Outcome("finished", ""), path.read_bytes())
