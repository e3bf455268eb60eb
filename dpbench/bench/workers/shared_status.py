"""Phase and output of a process, in memory shared with its supervisor.

Anonymous memory needs no room on a file system, cannot be removed, and outlives the process. It
tells whether the harness or the solver was at work when the process died.
"""

from __future__ import annotations

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

OUTPUT_BYTES = 2**20
"""What is kept of the output of one cell; the rest is dropped."""
CUT = f"its output was cut at {OUTPUT_BYTES // 2**20} MiB"
_HEAD = struct.Struct("iiI")
"""Who is at work, on which of its cells, and the bytes of the words behind it."""
_TEMPLATE = struct.Struct("ii")
"""What the process was forked from, and the keeper of that; behind the head."""
_PEAK = struct.Struct("d")
_PEAK_AT = _HEAD.size + _TEMPLATE.size
"""Where the peak of its memory [B] stands, of a process that ended by an exception."""
_WORDS = _PEAK_AT + _PEAK.size
_PACKAGE = Path(__file__).parents[2]
_BY_SOLVERS = (
    f"{_PACKAGE / 'solvers'}{os.sep}",
    str(_PACKAGE / "bench" / "run" / "timed_solver.py"),
)
"""Code of this package that only hands on what a solver does."""


class Phase(IntEnum):
    """Part of the program at work in a process."""

    STARTING = 0
    HARNESS = 1
    OPENING = 2
    SOLVER = 3

    @property
    def blames_solver(self) -> bool:
        """Whether a process that ends now was ended by its solver."""
        return self >= Phase.OPENING


class Output:
    """Output of a process and its children: a file in memory of fixed size.

    Its position is shared with the supervisor and tells how far it is filled.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None:
            descriptor = os.memfd_create("dpbench-output", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            os.truncate(descriptor, OUTPUT_BYTES)
            seals = fcntl.F_SEAL_GROW | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_SEAL
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, seals)
        self._descriptor = descriptor
        weakref.finalize(self, os.close, descriptor)

    def __reduce__(self) -> tuple[Callable[..., Output], tuple[Any, ...]]:
        return _receive_output, (reduction.DupFd(self._descriptor),)

    def take(self) -> None:
        """Redirect the output of this process to it."""
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(self._descriptor, number)
            sink = io.BufferedWriter(_Sink(number, "w", closefd=False))
            text = io.TextIOWrapper(sink, "utf-8", "replace", line_buffering=True)
            setattr(sys, name, text)

    def begin_again(self) -> None:
        """Forget earlier output."""
        with suppress(ValueError):
            sys.stdout.flush()
        os.lseek(self._descriptor, 0, os.SEEK_SET)

    @property
    def is_full(self) -> bool:
        """Whether output was dropped."""
        # A write may be refused whole for its last bytes.
        return self._end > OUTPUT_BYTES - 2**14

    @property
    def last_line(self) -> str:
        """Its last line; "" where there is none."""
        start = max(0, self._end - 4096)
        text = os.pread(self._descriptor, self._end - start, start).decode(errors="replace")
        return (text.strip().splitlines() or [""])[-1][:300]

    @property
    def _end(self) -> int:
        return os.lseek(self._descriptor, 0, os.SEEK_CUR)


class _Sink(io.FileIO):
    """A file that drops what it has no room for: a solver that prints must not fail by it."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return len(data)


def _receive_output(descriptor: Any) -> Output:
    return Output(descriptor.detach())


class SharedStatus:
    """The page of one process, shared with its supervisor; sent as an argument."""

    def __init__(self, descriptor: int | None = None, output: Output | None = None) -> None:
        self.output = output or Output()
        self._descriptor = os.memfd_create("dpbench-notice") if descriptor is None else descriptor
        if descriptor is None:
            # Written, not only made longer: this page must exist whatever becomes scarce.
            os.write(self._descriptor, bytes(mmap.PAGESIZE))
        self._page = mmap.mmap(self._descriptor, mmap.PAGESIZE)

    def __reduce__(self) -> tuple[Callable[..., SharedStatus], tuple[Any, ...]]:
        return _receive_status, (reduction.DupFd(self._descriptor), self.output)

    def handed_over(self) -> None:
        """Close the descriptor after the process has received it."""
        os.close(self._descriptor)

    def begin(self) -> None:
        """Write template and keeper of the process, and begin the phase of the harness.

        The process ends here if its template has died.
        """
        orphans.end_with_parent(orphans.template)
        orphans.adopt_orphans()
        _TEMPLATE.pack_into(self._page, _HEAD.size, orphans.template, orphans.keeper)
        self.set_phase(Phase.HARNESS)

    def set_phase(self, who: Phase, place: int | None = None) -> None:
        """Set the phase, and the number of the current one of several cells."""
        at = self.place if place is None else place
        _HEAD.pack_into(self._page, 0, who, at, 0)

    def record_exit(self, who: Phase, words: str) -> None:
        """Write the phase that ends the process, and the reason."""
        text = " ".join(words.split()).encode()[: mmap.PAGESIZE - _WORDS]
        self._page[_WORDS : _WORDS + len(text)] = text
        _PEAK.pack_into(self._page, _PEAK_AT, process_peak_bytes())
        _HEAD.pack_into(self._page, 0, who, self.place, len(text))

    @property
    def who(self) -> Phase:
        """The phase, or the last one of a process that ended."""
        return Phase(_HEAD.unpack_from(self._page)[0])

    @property
    def place(self) -> int:
        """Number of the current cell."""
        return int(_HEAD.unpack_from(self._page)[1])

    @property
    def template(self) -> int:
        """Process that this one was forked from; 0 before it began."""
        return int(_TEMPLATE.unpack_from(self._page, _HEAD.size)[0])

    @property
    def keeper(self) -> int:
        """Process above the template, which adopts orphans; 0 before it began."""
        return int(_TEMPLATE.unpack_from(self._page, _HEAD.size)[1])

    @property
    def peak_bytes(self) -> float:
        """Peak of its memory when an exception ended it; 0 for none."""
        return float(_PEAK.unpack_from(self._page, _PEAK_AT)[0])

    @property
    def words(self) -> str:
        """Reason why the process ended; "" where it recorded none."""
        length = _HEAD.unpack_from(self._page)[2]
        text = bytes(self._page[_WORDS : _WORDS + length])
        return text.decode(errors="replace")


def _receive_status(descriptor: Any, output: Output) -> SharedStatus:
    """Return the status in the process that it was sent to."""
    notice = SharedStatus(descriptor.detach(), output)
    notice.handed_over()
    return notice


_process_status: list[SharedStatus] = []
"""The notice of this process; none in one that nobody supervises."""


def set_phase(who: Phase, place: int | None = None) -> None:
    """Set the phase of this process, and the number of the current one of several cells."""
    for notice in _process_status:
        notice.set_phase(who, place)


def begin_output() -> None:
    """Forget the output of this process, as another cell begins."""
    for notice in _process_status:
        notice.output.begin_again()


def truncation_note() -> str:
    """Return `CUT` where output of this process was dropped; "" else."""
    return CUT if any(notice.output.is_full for notice in _process_status) else ""


def run(notice: SharedStatus, target: Callable[..., None], args: tuple[Any, ...]) -> None:
    """Run a process's target; record an exception as the reason of its end."""
    _process_status[:] = [notice]
    notice.begin()
    notice.output.take()
    mark_as_first_oom_victim()
    try:
        target(*args)
    except BaseException as error:  # SystemExit and a panic of Rust, too, are said and end here
        who = notice.who
        if isinstance(error, Exception) and not _is_from_solver(error.__traceback__):
            who = Phase.HARNESS
        notice.record_exit(who, describe_exception(error))
        raise SystemExit(1) from None


def describe_exception(error: BaseException) -> str:
    """Return what was raised, in half a line."""
    if isinstance(error, SystemExit):
        return f"SystemExit({error.code!r})"
    return f"{type(error).__name__}: {error}"[:300]


def _is_from_solver(trace: TracebackType | None) -> bool:
    """Return whether an exception came out of a solver, or of its adapter."""
    while trace is not None:
        if trace.tb_frame.f_code.co_filename.startswith(_BY_SOLVERS):
            return True
        trace = trace.tb_next
    return False
