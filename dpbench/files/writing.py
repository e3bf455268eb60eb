"""Write files into folders that others may have made: regular files only, never through a link.

A file is written under a new name beside its place and then renamed, which replaces a link and
leaves what it points to as it was. A folder that is a link is refused.
"""

import json
import os
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from dpbench.errors import InputError

MOST_NAME_BYTES = 120
_MOST_LIST_BYTES = 2**20


def is_plain_file_name(text: str) -> bool:
    """Return whether a text is a printable file name without folder or leading dot."""
    plain = text.isprintable() and not {"/", "\\"} & set(text) and not text.startswith(".")
    return plain and 0 < len(text.encode()) <= MOST_NAME_BYTES


def make_folder_if_missing(path: Path) -> Path:
    """Make a folder unless it exists and return its path; InputError if a link has its name."""
    if path.is_symlink():
        raise InputError(str(path), "", "a link", "a folder: nothing is written through a link")
    path.mkdir(exist_ok=True)
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
            raise InputError(str(folder), "", f"a file called {name!r}", "a name without a folder")
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
