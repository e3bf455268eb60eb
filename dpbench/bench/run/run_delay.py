"""Waits of a thread for its core, by the scheduler of the kernel."""

import os
import threading
from functools import cache

_LONGEST = 96
"""Bytes that three numbers of 64 bits take at most, with room to spare."""
UNKNOWN = -1


class RunDelay:
    """Meter of how long a thread was ready to run while its core ran something else.

    It is the second number of `schedstat` in proc(5), without sleep and waits for other threads.
    """

    def __init__(self) -> None:
        try:
            self._file = os.open("/proc/thread-self/schedstat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            # A kernel or a container that does not show it.
            self._file = -1
        self._before_ns = self._read_total_ns()

    def _read_total_ns(self) -> int:
        """Return how long the thread has waited for its core so far [ns]; `UNKNOWN` if hidden."""
        if self._file < 0:
            return UNKNOWN
        try:
            return int(os.pread(self._file, _LONGEST, 0).split()[1])
        except (OSError, IndexError, ValueError):
            self._file = -1
            return UNKNOWN

    def since_last(self) -> int:
        """Return how long the thread waited for its core since the last call [ns]; −1: unknown."""
        before_ns, now_ns = self._before_ns, self._read_total_ns()
        self._before_ns = now_ns
        return now_ns - before_ns if now_ns != UNKNOWN else UNKNOWN


@cache
def _cached_run_delay(thread: int) -> RunDelay:
    """Return the meter of a thread's waits for its core, one object for each thread."""
    return RunDelay()


def get_run_delay() -> RunDelay:
    """Return the meter of the calling thread's waits for its core, shared by its solvers."""
    # The identifier of a forked child is its own, so that it opens a file of its own.
    return _cached_run_delay(threading.get_native_id())
