"""Folders of raw logs, with a check for room before they are written.

They are in memory where possible, so that no write-back of a disk disturbs a step. A container has
some 64 MB of it where the replays of a suite can need 200, so that the next place is taken where
room is short. Folders of killed campaigns (`temporary_folders.py`) are removed first.
"""

import os
import sys
import tempfile
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import psutil

from dpbench.errors import DpbenchError
from dpbench.temporary_folders import (
    make_temporary_folder_for_block,
    remove_abandoned_temporary_folders,
)

MEMORY = Path("/dev/shm")  # The file system in memory that every Linux has, of whatever size
MARGIN_BYTES = 2**21  # For what lies beside the logs: verdicts, and what libraries print


class NoRoomError(DpbenchError):
    """Raised where no folder has room for raw logs."""


def open_scratch_folder() -> AbstractContextManager[Path]:
    """Return a context that yields a temporary folder, in memory where that can be written."""
    return make_temporary_folder_for_block(
        MEMORY if os.access(MEMORY, os.W_OK) else Path(tempfile.gettempdir())
    )


def count_free_bytes(place: Path) -> int:
    """Return the free bytes of a folder's file system, in memory at most those available."""
    volume = os.statvfs(place)
    # A tmpfs without a limit says that it has no blocks at all.
    free = volume.f_bavail * volume.f_frsize if volume.f_blocks else sys.maxsize
    return min(free, int(psutil.virtual_memory().available)) if place == MEMORY else free


def clear_scratch_folders(beside: Path) -> list[Path]:
    """Remove what killed campaigns left in temporary folders; return where to make new ones."""
    # One place on each file system.
    by_device: dict[int, Path] = {}
    for place in (MEMORY, Path(tempfile.gettempdir()), beside):
        if os.access(place, os.W_OK):
            by_device.setdefault(place.stat().st_dev, place)
    for place in by_device.values():
        remove_abandoned_temporary_folders(place)
    return list(by_device.values())


class Scratch(ExitStack):
    """Temporary folders of one campaign's raw logs; `beside`, on the results' disk, comes last."""

    def __init__(self, beside: Path) -> None:
        super().__init__()
        self._places = clear_scratch_folders(beside)
        self._made: dict[Path, Path] = {}
        self._elsewhere: dict[Path, list[tuple[int, str]]] = {}

    @property
    def remarks(self) -> list[str]:
        """A remark for each folder that was used because the usual one was full."""
        lines = []
        for place, parts in self._elsewhere.items():
            _, largest = max(parts)
            many = f"logs of {len(parts)} part{'s' if len(parts) > 1 else ''} of the campaign"
            lines.append(f"{many} lay in {place}: {largest}")
        return lines

    def choose_folder(self, need: int = 0, what: str = "") -> Path:
        """Return a folder with room for `need` bytes of raw logs; NoRoomError without any."""
        short: list[str] = []
        for place in self._places:
            free = count_free_bytes(place)
            if free < need + MARGIN_BYTES:
                short.append(f"{place} has {_format_megabytes(free)}")
                continue
            if short and need:
                words = f"{what} took {_format_megabytes(need)} where {' and '.join(short)} free"
                self._elsewhere.setdefault(place, []).append((need, words))
            return self._make_folder(place)
        if not need:
            return self._make_folder(self._places[-1])
        raise NoRoomError(
            f"no room for the logs of {what} ({_format_megabytes(need)}): "
            f"{' and '.join(short)} free"
        )

    def _make_folder(self, place: Path) -> Path:
        """Return this campaign's temporary folder within `place`; make it on first use."""
        if place not in self._made:
            self._made[place] = self.enter_context(make_temporary_folder_for_block(place))
        return self._made[place]


def _format_megabytes(size: int) -> str:
    """Format a size [B] in megabytes."""
    return f"{size / 1e6:.1f} MB"
