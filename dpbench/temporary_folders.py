"""Temporary folders that are removed with the process that made them.

A folder is locked as long as its process lives; the folder of a killed process is removed when the
next one makes a folder in the same place.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from multiprocessing.util import Finalize, get_temp_dir
from pathlib import Path

from dpbench.locks import FOLDER, try_hold_file_lock

PREFIX = "dpbench-scratch-"  # Beginning of the names of such folders alone
LONGEST = 70  # Bytes of the path of a folder of sockets: Linux allows 107, and Python adds up to 33
_LAST = -200  # Behind what `multiprocessing` does at the end of a process, whose last is −100
ATTEMPTS = 10  # To remove a folder that others still write to


@contextmanager
def make_temporary_folder_for_block(place: Path) -> Iterator[Path]:
    """Yield a private temporary folder below `place`, removed at the end of the block."""
    remove_abandoned_temporary_folders(place)
    # Nobody looks for this name: it gets the other when it is locked.
    made = Path(tempfile.mkdtemp(prefix=f".{PREFIX}", dir=place))
    with try_hold_file_lock(made, FOLDER):
        folder = made.rename(made.with_name(made.name.removeprefix(".")))
        try:
            yield folder
        finally:
            _remove_folder_with_retries(folder)


def remove_abandoned_temporary_folders(place: Path) -> None:
    """Remove temporary folders that processes which have ended left below `place`."""
    for folder in place.glob(f"{PREFIX}*"):
        with try_hold_file_lock(folder, FOLDER) as abandoned:
            if abandoned:
                _remove_folder_with_retries(folder)


def _remove_folder_with_retries(folder: Path) -> None:
    """Remove a folder, with retries while another process still writes to it."""
    for _ in range(ATTEMPTS):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return


_held: list[object] = []
"""Context of the folder of this process: a fork by `multiprocessing` clears the finalizers that it
inherits, and without another reference would remove its parent's folder."""


@cache
def process_temporary_folder() -> Path:
    """Return this process's temporary folder, removed at its end; OSError if none can be made."""
    made = make_temporary_folder_for_block(Path(tempfile.gettempdir()))
    folder = made.__enter__()
    _held.append(made)
    # In this process and in no fork of it, after the sockets in it are closed.
    Finalize(None, made.__exit__, args=(None, None, None), exitpriority=_LAST)
    return folder


def place_sockets_in_process_folder() -> None:
    """Make `multiprocessing` keep its sockets in this process's folder, if its path is short."""
    before = tempfile.tempdir
    try:
        folder = process_temporary_folder()
        if len(os.fsencode(folder)) <= LONGEST:
            tempfile.tempdir = str(folder)
        get_temp_dir()  # made at the first call, and kept
    finally:
        tempfile.tempdir = before
