"""Phase and output of a process, in memory shared with its supervisor.

Anonymous memory needs no room on a file system, cannot be removed, and outlives the process. It
tells whether the harness or the solver was at work when the process died.
"""

import ctypes
import fcntl
import io
import mmap
import os
import sys
import weakref
from collections.abc import Callable
from contextlib import suppress
from enum import IntEnum
from multiprocessing import reduction
from pathlib import Path
from types import TracebackType
from typing import Any

from dpbench.bench.run.footprint import mark_as_first_oom_victim, process_peak_bytes
from dpbench.bench.workers import orphans

OUTPUT_BYTES = 2**20  # What is kept of the output of one cell; the rest is dropped
CUT = f"its output was cut at {OUTPUT_BYTES // 2**20} MiB"
_REASON_BYTES = 3072  # What is kept of the reason why a process ended
_PACKAGE = Path(__file__).parents[2]
_BY_SOLVERS = (
    f"{_PACKAGE / 'solvers'}{os.sep}",
    str(_PACKAGE / "bench" / "run" / "timed_solver.py"),
)
"""Code of this package that only hands on what a solver does."""


class Phase(IntEnum):
    """Phases of a worker process: starting, benchmark's own work, solver, custom plant."""

    STARTING = 0
    HARNESS = 1
    OPENING = 2
    SOLVER = 3
    PLANT = 4

    @property
    def blames_solver(self) -> bool:
        """Return whether the solver is blamed for a process that ends in this phase."""
        return self in (Phase.OPENING, Phase.SOLVER)


class Output:
    """Captured output of a worker process, in memory of fixed size; its position is shared."""

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None:
            descriptor = os.memfd_create("dpbench-output", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            os.truncate(descriptor, OUTPUT_BYTES)
            seals = fcntl.F_SEAL_GROW | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_SEAL
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, seals)
        self._descriptor = descriptor
        weakref.finalize(self, os.close, descriptor)

    def __reduce__(self) -> "tuple[Callable[..., Output], tuple[Any, ...]]":
        return _receive_output, (reduction.DupFd(self._descriptor),)

    def redirect(self) -> None:
        """Redirect stdout and stderr of this process to the captured output."""
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(self._descriptor, number)
            sink = io.BufferedWriter(_Sink(number, "w", closefd=False))
            text = io.TextIOWrapper(sink, "utf-8", "replace", line_buffering=True)
            setattr(sys, name, text)

    def discard(self) -> None:
        """Discard the process output captured so far."""
        with suppress(ValueError):
            sys.stdout.flush()
        os.lseek(self._descriptor, 0, os.SEEK_SET)

    @property
    def is_full(self) -> bool:
        """Return whether the captured process output was cut for its length."""
        # A write may be refused whole for its last bytes.
        return self._size > OUTPUT_BYTES - 2**14

    @property
    def last_line(self) -> str:
        """The last line of the captured output; "" where there is none."""
        start = max(0, self._size - 4096)
        text = os.pread(self._descriptor, self._size - start, start).decode(errors="replace")
        return (text.strip().splitlines() or [""])[-1][:300]

    @property
    def _size(self) -> int:
        """Number of bytes of output captured so far."""
        return os.lseek(self._descriptor, 0, os.SEEK_CUR)


class _Sink(io.FileIO):
    """A file that drops what it has no room for, so that a printing solver does not fail."""

    def write(self, data: Any) -> int:
        """Write data, or drop it where there is no room; return its length in either case."""
        try:
            return super().write(data)
        except OSError:
            return len(data)


def _receive_output(descriptor: Any) -> Output:
    """Return captured output rebuilt from a descriptor, in the process that receives it."""
    return Output(descriptor.detach())


class _Page(ctypes.Structure):
    """Layout of the memory that a worker process shares with its supervisor.

    phase : or the last one of a process that has ended; cell_index : of its run in its batch.
    forkserver : process that it was forked from; keeper : process that adopts what it leaves; 0 for
        both before it began.
    peak_bytes : of its memory, when an exception ended it [B]; exit_reason : "" for none.
    step, steps : done and to do of the file that it makes; zeros where none are shown.
    fmu : file name of the FMU that is the plant; "" for none.
    """

    phase: int
    cell_index: int
    forkserver: int
    keeper: int
    step: int
    steps: int
    peak_bytes: float
    fmu: bytes
    exit_reason: bytes
    _fields_ = [
        *((name, ctypes.c_int) for name in ("phase", "cell_index", "forkserver", "keeper")),
        *(("step", ctypes.c_int), ("steps", ctypes.c_int), ("peak_bytes", ctypes.c_double)),
        *(("fmu", ctypes.c_char * 256), ("exit_reason", ctypes.c_char * _REASON_BYTES)),
    ]


class SharedStatus:
    """Phase, exit reason and output of a worker process, in memory shared with its supervisor."""

    def __init__(self, descriptor: int | None = None, output: Output | None = None) -> None:
        self.output = output or Output()
        self._descriptor = os.memfd_create("dpbench-notice") if descriptor is None else descriptor
        if descriptor is None:
            # Written, not only made longer: this page must exist whatever becomes scarce.
            os.write(self._descriptor, bytes(mmap.PAGESIZE))
        self.page = _Page.from_buffer(mmap.mmap(self._descriptor, mmap.PAGESIZE))

    def __reduce__(self) -> "tuple[Callable[..., SharedStatus], tuple[Any, ...]]":
        return _receive_status, (reduction.DupFd(self._descriptor), self.output)

    def close_descriptor(self) -> None:
        """Close the file descriptor after the worker process has received its own."""
        os.close(self._descriptor)

    def begin(self) -> None:
        """Record this worker's parents and first phase; have it end with the fork server."""
        orphans.end_with_parent(orphans.template)
        orphans.adopt_orphans()
        self.page.forkserver, self.page.keeper = orphans.template, orphans.keeper
        self.set_phase(Phase.HARNESS)

    def set_phase(self, phase: Phase, cell_index: int | None = None) -> None:
        """Set the phase that the worker is in, and the index of its current run."""
        self.page.phase, self.page.exit_reason = phase, b""
        if cell_index is not None:
            self.page.cell_index = cell_index

    def record_exit(self, phase: Phase, reason: str) -> None:
        """Record the phase in which the process ends, the reason, and its peak memory."""
        self.page.exit_reason = " ".join(reason.split()).encode()[:_REASON_BYTES]
        self.page.peak_bytes = process_peak_bytes()
        self.page.phase = phase

    @property
    def phase(self) -> Phase:
        """The current phase of the worker, or the last one of a process that has ended."""
        return Phase(self.page.phase)

    @property
    def exit_reason(self) -> str:
        """Reason why the process ended; "" where it recorded none."""
        return self.page.exit_reason.decode(errors="replace")


def _receive_status(descriptor: Any, output: Output) -> SharedStatus:
    """Return a shared status rebuilt from a descriptor, in the process that receives it."""
    notice = SharedStatus(descriptor.detach(), output)
    notice.close_descriptor()
    return notice


_process_status: list[SharedStatus] = []
"""The notice of this process; none in one that nobody supervises."""


def set_phase(phase: Phase, cell_index: int | None = None) -> None:
    """Report the phase that this process is in, and the index of its run, to the supervisor."""
    for notice in _process_status:
        notice.set_phase(phase, cell_index)


def set_step(done: int, steps: int) -> None:
    """Report to the supervisor how many of its steps the file has that this process makes."""
    for notice in _process_status:
        notice.page.step, notice.page.steps = done, steps


def set_fmu(name: str) -> None:
    """Report the file name of the FMU that this process runs to the supervisor."""
    for notice in _process_status:
        notice.page.fmu = name.encode(errors="replace")[:255]


def discard_captured_output() -> None:
    """Discard the output captured from this process so far, as another run begins."""
    for notice in _process_status:
        notice.output.discard()


def describe_truncated_output() -> str:
    """Return a note where this process's captured output was cut; "" otherwise."""
    return CUT if any(notice.output.is_full for notice in _process_status) else ""


def run_target(notice: SharedStatus, target: Callable[..., None], args: tuple[Any, ...]) -> None:
    """Run the main function of a worker process; record an exception as the reason of its end."""
    _process_status[:] = [notice]
    notice.begin()
    notice.output.redirect()
    mark_as_first_oom_victim()
    try:
        target(*args)
    except BaseException as error:  # SystemExit and a panic of Rust, too, are said and end here
        phase = notice.phase
        if isinstance(error, Exception) and not _is_from_solver(error.__traceback__):
            phase = Phase.HARNESS
        notice.record_exit(phase, describe_exception(error))
        raise SystemExit(1) from None


def describe_exception(error: BaseException) -> str:
    """Return type and message of an exception, in half a line."""
    if isinstance(error, SystemExit):
        return f"SystemExit({error.code!r})"
    return f"{type(error).__name__}: {error}"[:300]


def _is_from_solver(trace: TracebackType | None) -> bool:
    """Return whether an exception was raised in a solver or its adapter."""
    while trace is not None:
        if trace.tb_frame.f_code.co_filename.startswith(_BY_SOLVERS):
            return True
        trace = trace.tb_next
    return False
