"""Waits of a thread for its core, by the scheduler of the kernel; limits on time without them."""

import os
import threading
from functools import cache
from pathlib import Path

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
        self._before_ns = self.read_total_ns()

    def read_total_ns(self) -> int:
        """Return how long the thread has waited for its core so far [ns]; `UNKNOWN` if hidden."""
        if self._file < 0:
            return UNKNOWN
        try:
            return int(os.pread(self._file, _LONGEST, 0).split()[1])
        except (OSError, IndexError, ValueError):
            self._file = -1
            return UNKNOWN

    def read_wait_since_last_call_ns(self) -> int:
        """Return how long the thread waited for its core since the last call [ns]; −1: unknown."""
        before_ns, now_ns = self._before_ns, self.read_total_ns()
        self._before_ns = now_ns
        return now_ns - before_ns if now_ns != UNKNOWN else UNKNOWN

    @property
    def pending_ns(self) -> int:
        """Wait for the core since `read_wait_since_last_call_ns` [ns]; 0 if unknown."""
        return max(self.read_total_ns() - self._before_ns, 0)


@cache
def _cache_run_delay_of_thread(thread: int) -> RunDelay:
    """Return the meter of a thread's waits for its core, one object for each thread."""
    return RunDelay()


def get_run_delay() -> RunDelay:
    """Return the meter of the calling thread's waits for its core, shared by its solvers."""
    # The identifier of a forked child is its own, so that it opens a file of its own.
    return _cache_run_delay_of_thread(threading.get_native_id())


def read_process_wait_s(process: int) -> float:
    """Return how long a process's main thread waited for its core so far [s]; 0 if unknown."""
    try:
        text = Path(f"/proc/{process}/schedstat").read_text(encoding="ascii")
        return 1e-9 * int(text.split()[1])
    except (OSError, IndexError, ValueError):
        return 0.0


class RunLimit:
    """Limit on the calling thread's run time [ns]: time by a clock without waits for its core.

    Another process on the core thus stops no run. The waits are read only where the clock alone is
    beyond the limit; where the kernel hides them the clock alone counts.
    """

    def __init__(self, start_ns: int, limit_ns: int) -> None:
        self._start_ns, self._limit_ns = start_ns, limit_ns
        self._delay = get_run_delay()
        self._waited_before_ns = self._delay.read_total_ns()
        self._due_ns = start_ns + limit_ns

    def spent_ns(self, now_ns: int) -> int:
        """Return the run time from the start until `now_ns` of the clock, without waits."""
        waited_ns = self._delay.read_total_ns() - self._waited_before_ns
        return now_ns - self._start_ns - max(waited_ns, 0)

    def is_exceeded(self, now_ns: int) -> bool:
        """Return whether the run time until `now_ns` of the clock is beyond the limit."""
        if now_ns <= self._due_ns:
            return False
        left_ns = self._limit_ns - self.spent_ns(now_ns)
        self._due_ns = now_ns + left_ns
        return left_ns < 0
