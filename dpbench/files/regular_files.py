"""Open, parse and write regular files only, in folders that others may have made.

Only a file of an expected size is read: a FIFO or a device in place of a file would block or never
end, and a text parser takes up to a hundred times the size of its file in memory.

A file is written under a new name beside its place and then renamed, which replaces a link and
leaves what it points to as it was. A folder that is a link is refused.
"""

import csv
import io
import json
import os
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

from dpbench.errors import InputError, shorten_found

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
MOST_JSON_BYTES = 2**22  # Of a JSON document; empty objects take 24 times as much memory
MOST_DEPTH = 32
"""Levels of nested tables and arrays, and parts of a dotted key. dpbench itself has at most 8."""

_MOST_INTEGER = 2**1023


@contextmanager
def open_regular_file(
    path: Path,
    what: str = "a readable file",
    *,
    most_bytes: int | None = None,
    error: type[InputError] = InputError,
) -> Iterator[BufferedReader]:
    """Yield a file open to read bytes; `error` unless it is regular, of at most `most_bytes`."""
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
            kind = _KINDS.get(stat.S_IFMT(state.st_mode), "not a regular file")
            raise error(str(path), "", kind, what)
        if most_bytes is not None and state.st_size > most_bytes:
            allowed = f"{what} of at most {most_bytes} bytes"
            raise error(str(path), "", f"{state.st_size} bytes", allowed)
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
        found = f"{size} bytes that unpack to {unpacked} bytes"
        raise error(str(path), "", found, f"at most {most} unpacked bytes for a file of this size")


def read_json_object(
    path: Path, what: str, *, error: type[InputError] = InputError
) -> dict[str, Any]:
    """Read a JSON object from an untrusted file; raise `error` if it is damaged or too large."""
    data = read_bytes(path, "a JSON file", most_bytes=MOST_JSON_BYTES, error=error)
    try:
        document = parse_json(data.decode("utf-8"))
    except ValueError as failure:
        raise error(str(path), "", *describe_json_fault(failure, what)) from failure
    if not isinstance(document, dict):
        found = "a list" if isinstance(document, list) else shorten_found(document)
        raise error(str(path), "", found, "a JSON object")
    return document


def read_csv_rows(path: Path) -> list[list[str]]:
    """Read the rows of an untrusted CSV file but empty ones and comments; InputError if bad."""
    what = "a readable CSV file in UTF-8"
    content = read_bytes(path, what, most_bytes=MOST_TEXT_BYTES)
    try:
        lines = io.StringIO(content.decode("utf-8-sig"), newline="")
        rows = [row for row in csv.reader(lines) if row and not row[0].startswith("#")]
    except UnicodeDecodeError as error:
        found = f"0x{content[error.start]:02x}, which is not UTF-8"
        raise InputError(str(path), f"byte {error.start + 1}", found, what) from error
    except csv.Error as error:
        raise InputError(str(path), "", f"invalid CSV ({error})", what) from error
    return rows


class DepthError(ValueError):
    """Error for a document whose tables or arrays are nested too deeply."""


def describe_json_fault(error: ValueError, allowed: str) -> tuple[str, str]:
    """Return what an error of `parse_json` has found, and what is allowed instead."""
    if isinstance(error, DepthError):
        return str(error), f"at most {MOST_DEPTH} levels"
    return f"invalid JSON ({str(error)[:120]})", allowed


def parse_json(text: str) -> Any:
    """Parse untrusted JSON; ValueError if damaged, too large, too deep or not valid Unicode."""
    if len(text) > MOST_JSON_BYTES:
        raise ValueError(f"{len(text)} characters, more than {MOST_JSON_BYTES}")
    try:
        document = json.loads(text)
    except RecursionError as failure:
        raise DepthError("JSON nested too deeply") from failure
    refuse_deep_or_huge_values(document)
    if "\\ud" in text.lower():
        # An escape of half a surrogate pair gives a text that can be neither printed nor written.
        json.dumps(document, ensure_ascii=False).encode()
    return document


def refuse_deep_or_huge_values(document: object) -> None:
    """Raise ValueError for parsed JSON nested too deep, or with an integer beyond all floats."""
    depth = 0
    level: list[Any] = [document]
    while level:
        if any(isinstance(one, int) and abs(one) >= _MOST_INTEGER for one in level):
            raise ValueError("an integer of more than 300 digits")
        level = [one for one in level if isinstance(one, dict | list)]
        depth += bool(level)
        if depth > MOST_DEPTH:
            raise DepthError(f"more than {MOST_DEPTH} nested levels")
        level = [
            inner for one in level for inner in (one.values() if isinstance(one, dict) else one)
        ]


MOST_NAME_BYTES = 120
_MOST_LIST_BYTES = 2**20


def is_plain_file_name(text: str) -> bool:
    """Return whether a text is a printable file name without folder or leading dot."""
    plain = text.isprintable() and not {"/", "\\"} & set(text) and not text.startswith(".")
    return plain and 0 < len(text.encode()) <= MOST_NAME_BYTES


def make_folder_if_missing(path: Path) -> Path:
    """Make a folder unless it exists and return its path.

    InputError if a link or a file has its name, or the folder around it is missing.
    """
    if path.is_symlink():
        raise InputError(str(path), "", "a link", "a folder, as nothing is written through a link")
    try:
        path.mkdir(exist_ok=True)
    except (FileExistsError, NotADirectoryError, FileNotFoundError) as error:
        allowed = "a folder, or a new name in an existing folder"
        raise InputError(str(path), "", error.strerror, allowed) from error
    return path


def create_empty_file(path: Path) -> Path:
    """Make an empty regular file, in place of a file or link of its name; return the path."""
    path.unlink(missing_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    os.close(os.open(path, flags, 0o666))
    return path


@contextmanager
def write_file_atomically(path: Path) -> Iterator[Path]:
    """Yield a new file that replaces the one at `path` when the block ends, or not at all."""
    part = create_empty_file(path.with_name(f"{path.name}.part"))
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def rename_durably(part: Path, path: Path) -> None:
    """Rename a written file to its final name, so that it survives a power failure."""
    sync_path_to_disk(part)
    part.replace(path)
    sync_path_to_disk(path.parent)


def sync_path_to_disk(path: Path) -> None:
    """Flush a file or folder to the disk and wait until it is there."""
    number = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def write_bytes_atomically(path: Path, content: bytes) -> None:
    """Write bytes to a file, completely or not at all."""
    with write_file_atomically(path) as part:
        part.write_bytes(content)


def write_text_atomically(path: Path, text: str) -> None:
    """Write text to a file in UTF-8, completely or not at all; lone surrogates become `?`."""
    write_bytes_atomically(path, text.encode(errors="replace"))


def write_bytes_to_file_or_pipe(path: Path, content: bytes) -> None:
    """Write bytes to a file of the user's choice, which may be a device or a pipe."""
    if path.exists() and not stat.S_ISREG(path.stat().st_mode):
        path.write_bytes(content)
    else:
        write_bytes_atomically(path, content)


def write_file_set_into_folder(folder: Path, contents: Mapping[str, Callable[[], bytes]]) -> None:
    """Write a set of files into a folder, and remove files of an earlier set that are not in it.

    `contents` makes the bytes of each file by name; the list of them is kept beside
    them, and no other file is removed. InputError: the folder is a link, or a name is none of a
    file in it.
    """
    for name in contents:
        if not is_plain_file_name(name):
            raise InputError(str(folder), "", f"a file called {name!r}", "a name without a path")
    earlier, now = _read_names_of_written_files(make_folder_if_missing(folder)), set(contents)
    # Should this be interrupted, the next time has to know the files of both.
    _write_names_of_written_files(folder, earlier | now)
    for name in earlier - now:
        if stat.S_ISREG((folder / name).lstat().st_mode):
            (folder / name).unlink()
    for name, content in contents.items():
        write_bytes_atomically(folder / name, content())
    _write_names_of_written_files(folder, now)


def build_path_of_written_file_list(folder: Path) -> Path:
    """Return the path of the list of files that dpbench wrote into a folder together."""
    return folder.with_name(f".{folder.name}.json")


def _read_names_of_written_files(folder: Path) -> set[str]:
    """Read the names of files that dpbench wrote into a folder, as far as they exist."""
    path = build_path_of_written_file_list(folder)
    try:
        state = path.lstat()
        if not stat.S_ISREG(state.st_mode) or state.st_size > _MOST_LIST_BYTES:
            return set()
        names = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return set()
    named = names if isinstance(names, list) else []
    known = {name for name in named if isinstance(name, str) and is_plain_file_name(name)}
    return {name for name in known if os.path.lexists(folder / name)}


def _write_names_of_written_files(folder: Path, names: set[str]) -> None:
    """Write the names of files that dpbench wrote into a folder."""
    write_text_atomically(
        build_path_of_written_file_list(folder), json.dumps(sorted(names), indent=1) + "\n"
    )
