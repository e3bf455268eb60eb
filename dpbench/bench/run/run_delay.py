"""Time that a thread was ready to run while the machine ran something else on its core.

The kernel's scheduler adds it up for each thread: the second number of `schedstat` in proc(5). A
thread that sleeps or waits for another one adds nothing to it, so it separates a step that the
machine delayed from one that the solver delayed.
"""

from __future__ import annotations

import os
import threading
from functools import cache

_LONGEST = 96
"""Bytes that three numbers of 64 bits take at most, with room to spare."""
UNKNOWN = -1


class RunDelay:
    """The run delay of the thread that makes it, taken by turns."""

    def __init__(self) -> None:
        try:
            self._file = os.open("/proc/thread-self/schedstat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            # A kernel or a container that does not show it.
            self._file = -1
        self._before_ns = self._now_ns()

    def _now_ns(self) -> int:
        if self._file < 0:
            return UNKNOWN
        try:
            return int(os.pread(self._file, _LONGEST, 0).split()[1])
        except (OSError, IndexError, ValueError):
            self._file = -1
            return UNKNOWN

    def since_last(self) -> int:
        """Return the run delay since the last call, or since it was made [ns]; −1 if unknown."""
        before_ns, now_ns = self._before_ns, self._now_ns()
        self._before_ns = now_ns
        return now_ns - before_ns if now_ns != UNKNOWN else UNKNOWN


@cache
def _of_thread(thread: int) -> RunDelay:
    return RunDelay()


def run_delay() -> RunDelay:
    """Return the one run delay of the calling thread, which all its solvers share."""
    # The identifier of a forked child is its own, so that it opens a file of its own.
    return _of_thread(threading.get_native_id())
