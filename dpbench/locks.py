"""Locks between the processes of a machine (flock), with the names of their holders.

A lock is on a file or a folder, and ends with the process that holds it, however that ends. A
holder writes its process, its work and the time into the file, for those who wait. The locks of a
machine's cores, and of its quiet, are files in a folder of this user in the temporary directory.
"""

import fcntl
import json
import math
import os
import pwd
import stat
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import psutil

from dpbench.errors import InputError, SituationError

FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
FILE = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW  # Flags to open a lock
EXCLUSIVE, SHARED = fcntl.LOCK_EX, fcntl.LOCK_SH
MAX_BYTES = 2**16  # Largest part of a lock file that is read
MAX_WORK = 100  # Longest command of a holder
_POLL_S = 0.1


@dataclass(frozen=True)
class Holder:
    """A process that holds a lock: its work, start time [s since the epoch] and process ID."""

    work: str
    since: float = field(default_factory=time.time)
    pid: int = field(default_factory=os.getpid)

    def __str__(self) -> str:
        began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        return f"process {self.pid} ({self.work}, since {began})"

    @classmethod
    def from_json_line(cls, line: str) -> "Holder":
        """Parse a lock holder from a JSON line; ValueError, KeyError or TypeError if invalid."""
        entry = json.loads(line)
        work = "".join(c for c in str(entry["work"]) if c.isprintable())
        holder = cls(work, float(entry["since"]), int(entry["pid"]))
        str(holder)
        return holder


@dataclass(frozen=True)
class WaitLimit:
    """Longest wait for a lock [s]: 0 for none, None without a limit; InputError below zero."""

    limit_s: float | None = None

    def __post_init__(self) -> None:
        if self.limit_s is not None and not 0.0 <= self.limit_s < math.inf:
            raise InputError("`wait_s`", "", self.limit_s, "a number of seconds, 0 or more")


class BusyError(SituationError):
    """A file or folder lock that other processes still hold at the end of the wait."""


@contextmanager
def try_hold_file_lock(path: Path, opened_as: int) -> Iterator[bool]:
    """Hold a file lock during the block, without waiting; yield false if it cannot be locked."""
    with ExitStack() as stack:
        is_locked = False
        with suppress(OSError):
            lock = os.open(path, opened_as, 0o600)
            stack.callback(os.close, lock)
            fcntl.flock(lock, EXCLUSIVE | fcntl.LOCK_NB)
            is_locked = True
        yield is_locked


@contextmanager
def _wait_for_and_hold_lock(
    path: Path,
    opened_as: int,
    how: int,
    where: str,
    patience: WaitLimit,
    say_waiting: Callable[[str], None],
) -> Iterator[int | None]:
    """Wait for a file or folder lock and hold it during the block; yield its descriptor or None."""
    with ExitStack() as stack:
        locked = None
        # Without a folder for the file, or on a disk that has no locks.
        with suppress(OSError):
            lock = os.open(path, opened_as, 0o600)
            stack.callback(os.close, lock)
            if not _try_lock_open_file(lock, how):
                _wait_for_lock_or_raise_busy(lock, how, where, patience, say_waiting)
            locked = lock if _try_lock_open_file(lock, how) else None
        yield locked


@contextmanager
def hold_folder_lock(
    folder: Path, *, patience: WaitLimit, say_waiting: Callable[[str], None]
) -> Iterator[bool]:
    """Wait for a folder's exclusive lock, hold it during the block; yield whether it is held."""
    with _wait_for_and_hold_lock(
        folder, FOLDER, EXCLUSIVE, str(folder), patience, say_waiting
    ) as lock:
        yield lock is not None


def _wait_for_lock_or_raise_busy(
    lock: int, how: int, where: str, patience: WaitLimit, say_waiting: Callable[[str], None]
) -> None:
    """Wait for the lock of an open file; BusyError at the end of the wait."""
    if patience.limit_s != 0.0:
        say_waiting(describe_lock_holders(lock))
    if patience.limit_s is None:
        # In the kernel's queue, where another that releases and locks again goes to the end.
        fcntl.flock(lock, how)
        return
    end_s = time.monotonic() + patience.limit_s
    while time.monotonic() < end_s:
        time.sleep(_POLL_S)
        if _try_lock_open_file(lock, how):
            return
    waited = f" after a wait of {patience.limit_s:g} s" if patience.limit_s else ""
    remedy = "run it later, or allow a longer wait (option --wait, argument `wait_s` in Python)"
    raise BusyError(where, f"in use by {describe_lock_holders(lock)}{waited}; {remedy}")


def _try_lock_open_file(lock: int, how: int) -> bool:
    """Try to lock an open file; return whether it was free. OSError where locks are missing."""
    try:
        fcntl.flock(lock, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def describe_lock_holders(lock: int) -> str:
    """Return as text which processes hold the lock of an open file or folder."""
    named = _read_holders_named_in_lock_file(lock) or _read_holders_from_proc_locks(lock)
    return " and ".join(map(str, named)) or "another process (name unknown)"


def _read_holders_from_proc_locks(lock: int) -> list[Holder]:
    """Return the processes that hold a file's lock according to Linux's /proc/locks."""
    status = os.fstat(lock)
    device = status.st_dev
    place = f"{os.major(device):02x}:{os.minor(device):02x}:{status.st_ino}"
    found = []
    with suppress(OSError, ValueError, psutil.Error):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            # Those that wait for the lock have an arrow in the second column.
            kind, _, _, pid, file = line.split()[1:6]
            if kind == "FLOCK" and file == place and int(pid) != os.getpid():
                process = psutil.Process(int(pid))
                work = "".join(c for c in " ".join(process.cmdline()[1:]) if c.isprintable())
                found.append(Holder(work[:MAX_WORK], process.create_time(), process.pid))
    return found


def _read_holders_named_in_lock_file(lock: int) -> list[Holder]:
    """Return other living processes that a lock file names as holders; none for a folder."""
    found: list[Holder] = []
    if stat.S_ISDIR(os.fstat(lock).st_mode):
        return found
    # Anybody may have damaged the file.
    for line in os.pread(lock, MAX_BYTES, 0).decode(errors="replace").splitlines():
        with suppress(ValueError, KeyError, TypeError, OverflowError, OSError):
            holder = Holder.from_json_line(line)
            if holder.pid != os.getpid() and Path(f"/proc/{holder.pid}").exists():
                found.append(holder)
    return found


def _write_holders_into_lock_file(lock: int, named: Sequence[Holder]) -> None:
    """Write the processes that hold a lock into its file, a JSON line each."""
    with suppress(OSError):
        os.ftruncate(lock, 0)
        os.pwrite(lock, "".join(f"{json.dumps(asdict(one))}\n" for one in named).encode(), 0)


def find_safe_lock_folder() -> Path:
    """Return the folder of this user's lock files; InputError where others could write to it."""
    folder = Path(tempfile.gettempdir()) / f"dpbench-leases-{os.getuid()}"
    with suppress(OSError):
        folder.mkdir(0o700)
    with suppress(FileNotFoundError):
        if fault := _describe_lock_folder_fault(folder.lstat()):
            kind = fault.split()[1]
            raise SituationError(
                str(folder),
                f"found {fault}; required: a folder that you own and only you can write to; remove "
                f"the {kind}, or set TMPDIR to another folder",
            )
    return folder


def _describe_lock_folder_fault(found: os.stat_result) -> str:
    """Return why a lock folder cannot be trusted; "" for a safe one."""
    if not stat.S_ISDIR(found.st_mode):
        return "a link" if stat.S_ISLNK(found.st_mode) else "a file"
    if found.st_uid != os.getuid():
        return f"a folder of {_describe_user_by_number(found.st_uid)}"
    if found.st_mode & 0o022:
        return f"a folder that others can write to (mode {stat.S_IMODE(found.st_mode):o})"
    return ""


def _describe_user_by_number(uid: int) -> str:
    """Return the name of a user by number, in words."""
    try:
        return f"user {pwd.getpwuid(uid).pw_name}"
    except KeyError:
        return f"user {uid}"


@contextmanager
def hold_free_core_lock() -> Iterator[int]:
    """Lock a free processor core in the block, the first where all are leased; yield its number."""
    cores, folder = sorted(os.sched_getaffinity(0)), find_safe_lock_folder()
    for core in cores:
        with try_hold_file_lock(folder / f"core-{core}", FILE) as held:
            if held:
                yield core
                return
    yield cores[0]


def find_machine_lock_holders() -> list[Holder]:
    """Return the processes whose campaigns use this machine now, other than this one."""
    try:
        lock = os.open(find_safe_lock_folder() / "machine", os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return []
    try:
        return _read_holders_named_in_lock_file(lock)
    finally:
        os.close(lock)


@contextmanager
def hold_machine_lock(
    how: int,
    holder: Holder,
    *,
    patience: WaitLimit = WaitLimit(),
    say_waiting: Callable[[str], None] = lambda holders: None,
) -> Iterator[bool]:
    """Lock this machine against other campaigns in the block; yield false where locks do not work.

    how : EXCLUSIVE for timed replays, else SHARED.
    holder : this process, written into the file for those who wait.
    say_waiting : called once with the holders, before a wait.
    Raises BusyError at the end of the wait.
    """
    path = find_safe_lock_folder() / "machine"
    with _wait_for_and_hold_lock(path, FILE, how, "this machine", patience, say_waiting) as lock:
        if lock is not None:
            _write_holders_into_lock_file(lock, [*_read_holders_named_in_lock_file(lock), holder])
        try:
            yield lock is not None
        finally:
            if lock is not None:
                _write_holders_into_lock_file(lock, _read_holders_named_in_lock_file(lock))
