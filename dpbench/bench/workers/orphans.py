"""Find and end processes that a worker started and left.

The kernel hands an orphan to the nearest ancestor that requested it (PR_SET_CHILD_SUBREAPER,
prctl(2)), through any number of forks and sessions. That is the worker while it lives, and then the
keeper (`keeper.py`), which has no other child but the template.
"""

import ctypes
import os
import signal
import time
from contextlib import suppress
from pathlib import Path

_SET_PDEATHSIG, _SET_CHILD_SUBREAPER = 1, 36
_ALL_CHILDREN = 0x40000000  # `__WALL` of waitpid(2): children made by clone(2) too
END_S = 5.0
"""Time in which all orphans must be gone; a process in an uninterruptible call may take longer."""
_libc = ctypes.CDLL(None)
template = keeper = 0
"""The template and its keeper, in that and in what is forked from it; 0 elsewhere."""


def adopt_orphans() -> None:
    """Make this process the parent of descendants whose own parent ends."""
    _libc.prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_with_parent(parent: int) -> None:
    """Have the kernel kill this process when its parent ends."""
    _libc.prctl(_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)


def has_children() -> bool:
    """Return whether this process has any child, zombies included."""
    flags = os.WEXITED | os.WNOHANG | os.WNOWAIT | _ALL_CHILDREN
    try:
        os.waitid(os.P_ALL, 0, flags)
    except ChildProcessError:
        return False
    return True


def list_children(pid: int) -> list[int]:
    """Return the process ids of a process's children; none where it is gone."""
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except OSError:
        return _search_children(pid)
    return [int(number) for number in text.split()]


def _search_children(pid: int) -> list[int]:
    """Return the children of a process by a search of all processes."""
    import psutil  # the keeper does without it

    try:
        return [child.pid for child in psutil.Process(pid).children()]
    except psutil.NoSuchProcess:
        return []


def signal_process(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process that may be gone."""
    if pid > 0:
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, number)


def kill_forkserver(keeper: int) -> None:
    """Kill the process that workers are forked from; all workers end with it."""
    for child in list_children(keeper) if keeper else []:
        signal_process(child, signal.SIGKILL)


def end_orphans(keeper: int, template: int) -> None:
    """Kill processes that ended workers have left running, and wait for their end."""
    deadline = time.monotonic() + END_S
    while time.monotonic() < deadline:
        children = list_children(keeper) if keeper else []
        if template not in children or len(children) == 1:
            return
        # It waits for those that end, unless somebody stopped it.
        signal_process(keeper, signal.SIGCONT)
        for child in children:
            if child != template:
                signal_process(child, signal.SIGKILL)
        time.sleep(0.001)


def end_children() -> None:
    """Kill all children of this process and what they leave, and wait for their end."""
    deadline = time.monotonic() + END_S
    while time.monotonic() < deadline:
        for child in list_children(os.getpid()):
            signal_process(child, signal.SIGKILL)
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.001)
