"""Memory at its peak, threads, and allocations of a step; the memory limit of a worker.

Python's and NumPy's allocations are traced; calls of `malloc` inside a library are not countable,
so of the C heap only the growth is measured.
"""

import ctypes
import resource
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from math import isnan
from pathlib import Path
from typing import cast

import numpy as np
import psutil
from threadpoolctl import threadpool_info

from dpbench.bench.record.raw_log import RawLog, sum_phases_by_step_ns
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.qp.program import QPSequence

MOST_STEPS = 50
LIMIT_NS = 2e8
"""Run time of all passes of `measure_step_memory` together, by the slowest step before."""
_PASSES = 4


MEMORY_SHARE = 0.4
"""Share of the machine's memory for a cell's process, unless its suite sets another."""
_MEMORY_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""Files with a container's own limit, for both versions of control groups."""


def _read_proc_status(key: str, process: int | str = "self") -> float:
    """Return an entry of /proc/<process>/status [B or count]; NaN where there is none."""
    with suppress(OSError):
        text = Path(f"/proc/{process}/status").read_text(encoding="utf-8", errors="replace")
        for line in text.splitlines():
            name, _, value = line.partition(":")
            if name == key:
                number, *unit = value.split()
                return float(number) * (1024 if unit else 1)
    return float("nan")


def reset_peak_memory() -> None:
    """Reset the kernel's record of this process's peak memory, where it allows that."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def process_peak_bytes(process: int | str = "self") -> float:
    """Return the peak resident memory of a process [B]; NaN where it is gone."""
    return _read_proc_status("VmHWM", process)


@cache
def machine_memory_bytes() -> int:
    """Return the memory of this machine, or of its container [B]."""
    sizes = [int(psutil.virtual_memory().total)]
    for path in _MEMORY_LIMITS:
        with suppress(OSError, ValueError):
            sizes.append(int(Path(path).read_text(encoding="ascii")))
    return min(sizes)


def limit_further_memory(size: int) -> None:
    """Limit the data of this process, and of each that it starts, to `size` bytes more than now.

    RLIMIT_AS would refuse libraries, which reserve far more address space than they use.
    """
    hard, size_now = resource.getrlimit(resource.RLIMIT_DATA)[1], _read_proc_status("VmData")
    most = size + (0 if isnan(size_now) else int(size_now))
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def mark_as_first_oom_victim() -> None:
    """Let the kernel kill this process first when memory is full."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


class MemoryWatch:
    """Meter of a solver's peak memory: that of its process, less the benchmark's own part.

    Made before the solver's library is imported. The memory of a forked process at its birth is
    subtracted; an older process resets its peak first.
    """

    def __init__(self) -> None:
        reset_peak_memory()
        self._at_birth = _read_proc_status("VmRSS")
        self._peak_of_import = self._imported = self._harness = float("nan")
        self._left = 0.0

    def begin_replay(self) -> None:
        """Start measuring another replay's memory in this process, without that of earlier ones."""
        reset_peak_memory()
        self._left = _read_proc_status("VmRSS") - self._imported

    def record_memory_after_setup(self) -> None:
        """Record memory use after the solver's library is loaded, before QPs and log are."""
        if isnan(self._imported):
            self._peak_of_import = _read_proc_status("VmHWM") - self._at_birth
            self._imported = _read_proc_status("VmRSS")
        self._harness = -_read_proc_status("VmRSS")

    def record_memory_after_loading(self, log: RawLog) -> None:
        """Record memory use after QPs and log are loaded, with the log's pages mapped."""
        log.touch_pages()
        self._harness += _read_proc_status("VmRSS")

    def peak_bytes(self) -> float:
        """Return the solver's peak memory until now [B]."""
        since = _read_proc_status("VmHWM") - self._at_birth - self._left - max(0.0, self._harness)
        return max(self._peak_of_import, since)


def count_own_and_library_threads() -> tuple[float, float]:
    """Return the threads of this process, and the most a loaded BLAS or OpenMP would use."""
    pools = [int(pool["num_threads"]) for pool in threadpool_info()]
    return _read_proc_status("Threads"), float(max(pools, default=1))


class _HeapInfo(ctypes.Structure):
    """`struct mallinfo2` of glibc 2.33 and later (mallinfo(3))."""

    _NAMES = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _NAMES.split()]


@cache
def _load_mallinfo2() -> Callable[[], _HeapInfo] | None:
    """Return the C function mallinfo2; None without glibc 2.33."""
    try:
        function = ctypes.CDLL(None).mallinfo2
    except (OSError, AttributeError):
        return None
    function.restype = _HeapInfo
    return cast(Callable[[], _HeapInfo], function)


def heap_bytes_in_use() -> float:
    """Return the bytes in use of the C heap; NaN without glibc 2.33."""
    read = _load_mallinfo2()
    if read is None:
        return float("nan")
    info = read()
    return float(info.uordblks + info.hblkhd)


def count_affordable_steps(log: RawLog) -> int:
    """Return for how many steps memory can be measured within `LIMIT_NS`, by the slowest so far."""
    slowest = sum_phases_by_step_ns(log.times).max()
    return int(min(MOST_STEPS, log.times.shape[1], LIMIT_NS / _PASSES / max(1.0, slowest)))


def measure_step_memory(
    sequence: QPSequence, solver: TimedSolver, steps: int
) -> tuple[float, float, float]:
    """Return medians of memory blocks left, peak bytes and heap growth [B] of untimed solves.

    The peak is that of traced bytes above the start of the step.
    """
    if steps < 1:
        return float("nan"), float("nan"), float("nan")
    made = [solver.formulate(sequence.step(k)) for k in range(steps)]

    def answer(k: int) -> None:
        if not solver.answer(made[k]).status.is_usable:
            solver.reset()

    growth = []
    for _ in range(_PASSES - 1):
        before = heap_bytes_in_use()
        for k in range(steps):
            answer(k)
        growth.append((heap_bytes_in_use() - before) / steps)
    # Arrays, because a list of counts would be counted as well.
    blocks, peaks = np.zeros(steps, dtype=np.int64), np.zeros(steps, dtype=np.int64)
    tracemalloc.start()
    for k in range(steps):
        tracemalloc.reset_peak()
        peaks[k] -= tracemalloc.get_traced_memory()[0]
        blocks[k] -= sys.getallocatedblocks()
        solution = solver.answer(made[k])
        blocks[k] += sys.getallocatedblocks()
        peaks[k] += tracemalloc.get_traced_memory()[1]
        if not solution.status.is_usable:
            solver.reset()
        # Or the next step would free this answer while its own are counted.
        del solution
    tracemalloc.stop()
    # Of passes the median: what is allocated once, or served from freed memory, is no step's.
    return float(np.median(blocks)), float(np.median(peaks)), float(np.median(growth))
