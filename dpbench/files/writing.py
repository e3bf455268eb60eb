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


def is_file_name(text: str) -> bool:
    """Whether a text names a file in the very folder it is put into."""
    plain = text.isprintable() and not {"/", "\\"} & set(text) and not text.startswith(".")
    return plain and 0 < len(text.encode()) <= MOST_NAME_BYTES


def make_folder(path: Path) -> Path:
    """Make a folder where there is none.

    Raises
    ------
    InputError : a link stands in its place.
    """
    if path.is_symlink():
        raise InputError(str(path), "", "a link", "a folder: nothing is written through a link")
    path.mkdir(exist_ok=True)
    return path


def new_file(path: Path) -> Path:
    """Make an empty regular file in place of whatever file or link has its name."""
    path.unlink(missing_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    os.close(os.open(path, flags, 0o666))
    return path


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Provide a new file that replaces `path` when the block ends, whole or not at all."""
    part = new_file(path.with_name(f"{path.name}.part"))
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def replace_durably(part: Path, path: Path) -> None:
    """Give a written file its name, so that both survive a power failure from then on."""
    sync(part)
    part.replace(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    number = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all."""
    with replace_file(path) as part:
        part.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a file in UTF-8, whole or not at all; what has no place there becomes `?`."""
    write_bytes(path, text.encode(errors="replace"))


def write_named_file(path: Path, content: bytes) -> None:
    """Write a file that a person named, which may be a device or a pipe too."""
    if path.exists() and not stat.S_ISREG(path.stat().st_mode):
        path.write_bytes(content)
    else:
        write_bytes(path, content)


def write_together(folder: Path, contents: Mapping[str, Callable[[], bytes]]) -> None:
    """Write the files of a folder anew, and remove those of an earlier time that are none now.

    A list beside the folder, `list_path` it, has their names: no other file is removed.

    Parameters
    ----------
    contents : by the name of each file, what makes its bytes.

    Raises
    ------
    InputError : the folder is a link, or a name is none of a file in it.
    """
    for name in contents:
        if not is_file_name(name):
            raise InputError(str(folder), "", f"a file called {name!r}", "a name without a folder")
    earlier, now = _read_list(make_folder(folder)), set(contents)
    # Should this be interrupted, the next time has to know the files of both.
    _write_list(folder, earlier | now)
    for name in earlier - now:
        if stat.S_ISREG((folder / name).lstat().st_mode):
            (folder / name).unlink()
    for name, content in contents.items():
        write_bytes(folder / name, content())
    _write_list(folder, now)


def list_path(folder: Path) -> Path:
    """Return the file with the names of what `write_together` wrote into a folder."""
    return folder.with_name(f".{folder.name}.json")


def _read_list(folder: Path) -> set[str]:
    """Return the files written earlier that are there; anybody may have changed their list."""
    path = list_path(folder)
    try:
        state = path.lstat()
        if not stat.S_ISREG(state.st_mode) or state.st_size > _MOST_LIST_BYTES:
            return set()
        names = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return set()
    named = names if isinstance(names, list) else []
    known = {name for name in named if isinstance(name, str) and is_file_name(name)}
    return {name for name in known if os.path.lexists(folder / name)}


def _write_list(folder: Path, names: set[str]) -> None:
    write_text(list_path(folder), json.dumps(sorted(names), indent=1) + "\n")
