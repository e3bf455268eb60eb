"""The files that QPs are made from, beside the results, each as long as a cell needs it."""

import re
from collections.abc import Collection
from pathlib import Path

_SOURCE = re.compile(r"exact-(?P<key>\w+)(?:\.part)*\.npz")


class SourceFiles:
    """Those of one campaign.

    Parameters
    ----------
    folder : where they lie; kept : keys of those that hold what the result folder shows.
    """

    def __init__(self, folder: Path, kept: Collection[str] = ()) -> None:
        self.folder, self._kept = folder, set(kept)

    def path(self, key: str) -> Path:
        """Where the source of that key lies."""
        return self.folder / f"exact-{key}.npz"

    def remove(self, key: str) -> None:
        """Remove the source of a key, unless it is kept."""
        if key not in self._kept:
            self.path(key).unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove all but those that are kept, also what an interrupted campaign left."""
        for path in self.folder.iterdir():
            own = _SOURCE.fullmatch(path.name)
            if own and own["key"] not in self._kept:
                path.unlink(missing_ok=True)
