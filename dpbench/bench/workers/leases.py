"""What processes that know nothing of each other share on a machine, by locks of the kernel.

A lock (flock) is on a file or a folder that all of them know, and ends with the process that holds
it, however that ends.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
FILE = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
"""How what is locked is opened."""
ALONE, TOGETHER = fcntl.LOCK_EX, fcntl.LOCK_SH


@contextmanager
def lease(path: Path, opened_as: int, how: int = ALONE | fcntl.LOCK_NB) -> Iterator[bool]:
    """A lock as long as the block lasts; false where another holds it, where it is another user's,
    or where the disk knows no locks."""
    with ExitStack() as stack:
        held = False
        with suppress(OSError):
            lock = os.open(path, opened_as, 0o600)
            stack.callback(os.close, lock)
            fcntl.flock(lock, how)
            held = True
        yield held


def _of_user(name: str) -> Path:
    """A file that all processes of this user on this machine know."""
    folder = Path(tempfile.gettempdir()) / f"dpbench-leases-{os.getuid()}"
    with suppress(OSError):
        folder.mkdir(0o700, exist_ok=True)
    return folder / name


@contextmanager
def leased_core() -> Iterator[int]:
    """A core that this process may use and that nobody else leases as long as the block lasts.

    Where all are leased, the first of them: more work was given to the machine than it has cores.
    """
    cores = sorted(os.sched_getaffinity(0))
    for core in cores:
        with lease(_of_user(f"core-{core}"), FILE) as held:
            if held:
                yield core
                return
    yield cores[0]


@contextmanager
def leased_machine(how: int, say_waiting: Callable[[], None]) -> Iterator[bool]:
    """This machine, for whoever times on it ALONE, or TOGETHER with all who do not; false where
    there is no knowing of others.

    Parameters
    ----------
    say_waiting : called once where others have it.
    """
    path = _of_user("machine")
    with lease(path, FILE, how | fcntl.LOCK_NB) as held:
        if held:
            yield True
            return
    say_waiting()
    with lease(path, FILE, how) as held:
        yield held
