"""Locks between the processes of a machine (flock), with the name of who holds one.

A lock is on a file or a folder that all processes know, and ends with the process that holds it,
however that ends. A holder writes its process, its work and the time into the file, for those who
wait.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dpbench.errors import InputError

FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
FILE = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
"""How what is locked is opened."""
ALONE, TOGETHER = fcntl.LOCK_EX, fcntl.LOCK_SH
MAX_BYTES = 2**16
"""Of a lock file that is read."""
_POLL_S = 0.1


@dataclass(frozen=True)
class Patience:
    """How long a lock that others hold is waited for.

    Parameters
    ----------
    limit_s : the longest wait, 0 for none; None without a limit.
    required : whether `BusyError` is raised after it; else work goes on without the lock.
    """

    limit_s: float | None = None
    required: bool = True


FOR_NOBODY = Patience(0.0, required=False)
"""For work whose measurements nobody keeps."""


class BusyError(InputError):
    """A lock that others still hold at the end of the wait; `found` names them."""


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


@contextmanager
def lock_file(
    path: Path,
    how: int,
    work: str,
    *,
    where: str,
    patience: Patience = Patience(),
    say_waiting: Callable[[str], None] = lambda holders: None,
) -> Iterator[bool]:
    """The lock of a file as long as the block lasts; false where there is none to be had.

    Parameters
    ----------
    how : ALONE, or TOGETHER with others that ask for that.
    work : what this process does meanwhile, for those who wait for it.
    where : what is locked, for the error.
    say_waiting : called once with the holders, before a wait.

    Raises
    ------
    BusyError : see `Patience`.
    """
    with ExitStack() as stack:
        try:
            lock = os.open(path, FILE, 0o600)
        except OSError:
            yield False
            return
        stack.callback(os.close, lock)
        held = _acquire(lock, how, where, patience, say_waiting)
        if held:
            _rewrite(lock, {"pid": os.getpid(), "work": work, "since": time.time()})
            stack.callback(_rewrite, lock)
        yield held


def _acquire(
    lock: int, how: int, where: str, patience: Patience, say_waiting: Callable[[str], None]
) -> bool:
    """Lock an open file, waiting for others as long as `patience` allows."""
    if _locked(lock, how | fcntl.LOCK_NB):
        return True
    if patience.limit_s == 0.0 and not patience.required:
        return False
    if patience.limit_s != 0.0:
        say_waiting(holders(lock))
    if patience.limit_s is None:
        # In the kernel's queue, where another that releases and locks again goes to the end.
        return _locked(lock, how)
    end_s = time.monotonic() + patience.limit_s
    while time.monotonic() < end_s:
        time.sleep(_POLL_S)
        if _locked(lock, how | fcntl.LOCK_NB):
            return True
    if patience.required:
        waited = f" after {patience.limit_s:g} s" if patience.limit_s else ""
        found = f"in use by {holders(lock)}{waited}"
        raise BusyError(where, "", found, "to wait for it (--wait SECONDS), or another")
    return False


def _locked(lock: int, how: int) -> bool:
    try:
        fcntl.flock(lock, how)
    except OSError:
        return False
    return True


def holders(lock: int) -> str:
    """Who holds the lock of an open file, in words: process, work, and since when."""
    others = [_in_words(entry) for entry in _entries(lock)]
    return " and ".join(others) or "another process, which left no name"


def _in_words(entry: dict[str, Any]) -> str:
    since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry["since"]))
    return f"process {entry['pid']} ({entry['work']}, since {since})"


def _entries(lock: int) -> list[dict[str, Any]]:
    """What other processes that live wrote into a lock file; anybody may have damaged it."""
    found = []
    for line in os.pread(lock, MAX_BYTES, 0).decode(errors="replace").splitlines():
        with suppress(ValueError, KeyError, TypeError, OverflowError):
            entry = json.loads(line)
            pid, since = int(entry["pid"]), float(entry["since"])
            work = "".join(c for c in str(entry["work"]) if c.isprintable())
            if pid > 0 and pid != os.getpid() and Path(f"/proc/{pid}").exists():
                time.localtime(since)
                found.append({"pid": pid, "work": work, "since": since})
    return found


def _rewrite(lock: int, own: dict[str, Any] | None = None) -> None:
    """Write the entries of others and the own one into a lock file; without `own`, those of others
    alone. Of two that do so at once one may go unnamed."""
    entries = [*_entries(lock), *([own] if own else [])]
    data = "".join(f"{json.dumps(entry)}\n" for entry in entries).encode()
    with suppress(OSError):
        os.ftruncate(lock, 0)
        os.pwrite(lock, data, 0)
