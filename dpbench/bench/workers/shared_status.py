"""Phase and output of a process, in memory shared with its supervisor.

Anonymous memory needs no room on a file system, cannot be removed, and outlives the process. It
tells whether the harness or the solver was at work when the process died.
"""

import fcntl
import io
import mmap
import os
import struct
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
_HEAD = struct.Struct("iiI")
"""Layout of the head: the process at work, the cell it is at, and the bytes of the words that
follow."""
_TEMPLATE = struct.Struct("ii")
"""Layout of the process it was forked from and that one's supervisor; behind the head."""
_PEAK = struct.Struct("d")
_PEAK_AT = _HEAD.size + _TEMPLATE.size
"""Offset of the peak of memory [B] of a process that ended by an exception."""
_STEP = struct.Struct("ii")
_STEP_AT = _PEAK_AT + _PEAK.size
"""Offset of the steps done and to do of the file that the process makes; zeros for none."""
_FMU = struct.Struct("256p")
_FMU_AT = _STEP_AT + _STEP.size
"""Offset of the file name of the FMU that is the plant; "" for none."""
_WORDS = _FMU_AT + _FMU.size
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


class SharedStatus:
    """Phase, exit reason and output of a worker process, in memory shared with its supervisor."""

    def __init__(self, descriptor: int | None = None, output: Output | None = None) -> None:
        self.output = output or Output()
        self._descriptor = os.memfd_create("dpbench-notice") if descriptor is None else descriptor
        if descriptor is None:
            # Written, not only made longer: this page must exist whatever becomes scarce.
            os.write(self._descriptor, bytes(mmap.PAGESIZE))
        self._page = mmap.mmap(self._descriptor, mmap.PAGESIZE)

    def __reduce__(self) -> "tuple[Callable[..., SharedStatus], tuple[Any, ...]]":
        return _receive_status, (reduction.DupFd(self._descriptor), self.output)

    def close_descriptor(self) -> None:
        """Close the file descriptor after the worker process has received its own."""
        os.close(self._descriptor)

    def begin(self) -> None:
        """Record this worker's parents and first phase; have it end with the fork server."""
        orphans.end_with_parent(orphans.template)
        orphans.adopt_orphans()
        _TEMPLATE.pack_into(self._page, _HEAD.size, orphans.template, orphans.keeper)
        self.set_phase(Phase.HARNESS)

    def set_phase(self, phase: Phase, cell_index: int | None = None) -> None:
        """Set the phase that the worker is in, and the index of its current run."""
        at = self.cell_index if cell_index is None else cell_index
        _HEAD.pack_into(self._page, 0, phase, at, 0)

    def set_step(self, done: int, steps: int) -> None:
        """Set how many of its steps the file that the worker makes has; zeros to show none."""
        _STEP.pack_into(self._page, _STEP_AT, done, steps)

    def set_fmu(self, name: str) -> None:
        """Set the file name of the FMU that the worker runs; its first 255 bytes are kept."""
        _FMU.pack_into(self._page, _FMU_AT, name.encode(errors="replace"))

    def record_exit(self, phase: Phase, reason: str) -> None:
        """Record the phase in which the process ends, the reason, and its peak memory."""
        text = " ".join(reason.split()).encode()[: mmap.PAGESIZE - _WORDS]
        self._page[_WORDS : _WORDS + len(text)] = text
        _PEAK.pack_into(self._page, _PEAK_AT, process_peak_bytes())
        _HEAD.pack_into(self._page, 0, phase, self.cell_index, len(text))

    @property
    def phase(self) -> Phase:
        """The current phase of the worker, or the last one of a process that has ended."""
        return Phase(_HEAD.unpack_from(self._page)[0])

    @property
    def cell_index(self) -> int:
        """Index of the worker's current run in its batch."""
        return int(_HEAD.unpack_from(self._page)[1])

    @property
    def step(self) -> tuple[int, int]:
        """Steps done and to do of the file that the worker makes; zeros where none are shown."""
        done, steps = _STEP.unpack_from(self._page, _STEP_AT)
        return int(done), int(steps)

    @property
    def fmu(self) -> str:
        """File name of the FMU that the worker runs; "" where it runs none."""
        name: bytes = _FMU.unpack_from(self._page, _FMU_AT)[0]
        return name.decode(errors="replace")

    @property
    def forkserver(self) -> int:
        """Id of the process this worker was forked from; 0 before the worker began."""
        return int(_TEMPLATE.unpack_from(self._page, _HEAD.size)[0])

    @property
    def keeper(self) -> int:
        """Id of the process that adopts what this worker leaves running; 0 before it began."""
        return int(_TEMPLATE.unpack_from(self._page, _HEAD.size)[1])

    @property
    def peak_bytes(self) -> float:
        """Peak memory when an exception ended the process [B]; 0 for none."""
        return float(_PEAK.unpack_from(self._page, _PEAK_AT)[0])

    @property
    def exit_reason(self) -> str:
        """Reason why the process ended; "" where it recorded none."""
        length = _HEAD.unpack_from(self._page)[2]
        text = bytes(self._page[_WORDS : _WORDS + length])
        return text.decode(errors="replace")


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
        notice.set_step(done, steps)


def set_fmu(name: str) -> None:
    """Report the file name of the FMU that this process runs to the supervisor."""
    for notice in _process_status:
        notice.set_fmu(name)


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
