"""Open files that others made: only a regular file of an expected size is read.

A FIFO or a device in place of a file would block or never end, and a text parser takes up to a
hundred times the size of its file in memory.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from dpbench.errors import InputError

MOST_TEXT_BYTES = 2**20
"""Largest TOML or CSV file that is read [B]. The largest that ships has 6 kB; tomllib reads a
megabyte in a second."""
FREE_BYTES, MOST_RATIO = 2**26, 100
"""Limits of unpacking a compressed file: bytes that are always allowed, and beyond them multiples
of its size. Sequences that ship need at most 53 times, a million runs of a single step some 60."""
# Without a writer at its other end, a FIFO would keep a blocking open for ever.
_FLAGS = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


@contextmanager
def open_regular_file(
    path: Path,
    what: str = "a readable file",
    *,
    most_bytes: int | None = None,
    error: type[InputError] = InputError,
) -> Iterator[BinaryIO]:
    """Open a file to read bytes; `error` unless it is a regular `what` of at most `most_bytes`."""
    try:
        number = os.open(path, _FLAGS)
    except FileNotFoundError as failure:
        raise error(str(path), "", "no such file", what) from failure
    except (OSError, ValueError) as failure:
        found = getattr(failure, "strerror", None) or str(failure)
        raise error(str(path), "", found, what) from failure
    try:
        state = os.fstat(number)
        if not stat.S_ISREG(state.st_mode):
            kind = _KINDS.get(stat.S_IFMT(state.st_mode), "no regular file")
            raise error(str(path), "", kind, what)
        if most_bytes is not None and state.st_size > most_bytes:
            raise error(str(path), "", f"{state.st_size} bytes", f"at most {most_bytes}: {what}")
        with open(number, "rb", closefd=False) as file:
            yield file
    finally:
        os.close(number)


def read_bytes(
    path: Path, what: str, *, most_bytes: int, error: type[InputError] = InputError
) -> bytes:
    """Read an untrusted regular file of at most `most_bytes`; `error` if it cannot be read."""
    with open_regular_file(path, what, most_bytes=most_bytes, error=error) as file:
        try:
            return file.read(most_bytes)
        except OSError as failure:
            found = failure.strerror or str(failure)
            raise error(str(path), "", found, what) from failure


def refuse_implausible_unpacked_size(
    path: Path, unpacked: int, size: int, *, error: type[InputError] = InputError
) -> None:
    """Raise `error` if a compressed file would unpack to far more bytes than plausible."""
    most = FREE_BYTES + MOST_RATIO * size
    if unpacked > most:
        found = f"{size} bytes that unpack to {unpacked}"
        raise error(str(path), "", found, f"at most {most} of a file of that size")
