"""Locks shared by separate processes of a user on a machine: its cores, and its quiet.

They are locks of files in a folder of this user in the temporary directory.
"""

import os
import pwd
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from dpbench.errors import InputError
from dpbench.locks import FILE, Holder, WaitLimit, lock_file, try_lease


def open_lease_folder() -> Path:
    """Return the folder of this user's lock files; InputError where others could write to it."""
    folder = Path(tempfile.gettempdir()) / f"dpbench-leases-{os.getuid()}"
    with suppress(OSError):
        folder.mkdir(0o700)
    with suppress(FileNotFoundError):
        if fault := _describe_folder_fault(folder.lstat()):
            allowed = "a folder of your own that only you can write; remove it, or set TMPDIR"
            raise InputError(str(folder), "", fault, allowed)
    return folder


def _describe_folder_fault(found: os.stat_result) -> str:
    """Return why a lock folder cannot be trusted; "" for a safe one."""
    if not stat.S_ISDIR(found.st_mode):
        return "a link" if stat.S_ISLNK(found.st_mode) else "a file"
    if found.st_uid != os.getuid():
        return f"a folder of {_user_name(found.st_uid)}"
    if found.st_mode & 0o022:
        return f"a folder that others can write (mode {stat.S_IMODE(found.st_mode):o})"
    return ""


def _user_name(uid: int) -> str:
    try:
        return f"user {pwd.getpwuid(uid).pw_name}"
    except KeyError:
        return f"user {uid}"


@contextmanager
def lease_core() -> Iterator[int]:
    """Lock a free processor core in the block, the first where all are leased; yield its number."""
    cores, folder = sorted(os.sched_getaffinity(0)), open_lease_folder()
    for core in cores:
        with try_lease(folder / f"core-{core}", FILE) as held:
            if held:
                yield core
                return
    yield cores[0]


def lease_machine(
    how: int,
    holder: Holder,
    *,
    patience: WaitLimit = WaitLimit(),  # noqa: B008 - frozen
    say_waiting: Callable[[str], None] = lambda holders: None,
) -> AbstractContextManager[bool]:
    """Lock this machine against other campaigns: exclusively for timed replays, else shared.

    Returns false where locks do not work. Parameters and errors as in `lock_file`.
    """
    path, where = open_lease_folder() / "machine", "this machine"
    return lock_file(path, how, holder, where=where, patience=patience, say_waiting=say_waiting)
