"""The raw log of a cell: named arrays in one memory-mapped file that survives a crash.

The worker only assigns into the arrays; its supervisor opens the same file after a crash, a hang or
a kill and finds every completed step.
"""

import errno
import json
import math
import mmap
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Floats, Ints

Layout = dict[str, tuple[str, tuple[int, ...]]]
"""Type and shape of each array of a log, in their order."""
_ALIGN = 64
PHASES = ("emit", "setup", "update", "solve", "read", "overhead")
"""Order of the phases in `RawLog.times`; −1 where a phase did not take place."""
_OWN = slice(PHASES.index("setup"), PHASES.index("read") + 1)
SOLVER_PHASES = PHASES[_OWN]
"""The phases that are the solver's: a step takes their sum."""

ALLOCATION = "allocation."
"""Prefix of the arrays that hold the answers to the second QP of a cascade."""

BACKUP = "backup."
"""Prefix of the arrays that hold the answers of the backup (`bench/run/backup.py`)."""

LOAD_PASSES = 4
"""Timings of the load kernel before a round, and as many after it (`replay.py`)."""
COUNTERS = (
    "replay_s",
    "voluntary_switches",
    "involuntary_switches",
    "steal_s",
    "throttle_events",
    "thread_s",
)
"""Counters of a round, or of a closed loop, in `RawLog.counters` (`disturbance.py`); NaN where the
kernel hides them."""
FOOTPRINT = (
    "peak_rss_bytes",
    "os_threads",
    "pool_threads",
    "python_blocks_per_step",
    "python_peak_bytes_per_step",
    "heap_growth_bytes_per_step",
)
"""Figures of a worker's memory and threads in `RawLog.footprint` (`footprint.py`); NaN where not
measured."""


def make_loop_layout(
    steps: int,
    n: int,
    m: int,
    n_theta: int,
    n_f: int = 0,
    allocation: tuple[int, int] | None = None,
    *,
    backup: bool = False,
    states: int = 6,
    inputs: int = 3,
) -> Layout:
    """Return type and shape of every array that records a closed loop of `steps` steps.

    n, m : of the QPs; n_theta : length of [θ; 1]; n_f : of the forces of commanded thrusters.
    allocation : n and m of the second QP of a cascade, (0, 0) where it has none; None for no
        cascade.
    states, inputs : of the plant; a ship's state, and the force on it.
    """
    layout = _make_answer_layout(1, steps, n, m) | {
        "theta": ("f8", (steps, n_theta)),
        "state": ("f8", (steps + 1, states)),
        "tau": ("f8", (steps, inputs)),
        "thrust": ("f8", (steps, n_f)),
        "command": ("f8", (steps, n_f if n_f and allocation is None else inputs)),
        "flags": ("u1", (steps, 3)),
        "latency_ns": ("i8", (steps,)),
        "counters": ("f8", (1, len(COUNTERS))),
    }
    if backup:
        of_backup = _make_answer_layout(1, steps, n, m)
        of_backup |= {"acted": ("u1", (steps,)), "ready_ns": ("i8", (steps,))}
        layout |= {f"{BACKUP}{name}": array for name, array in of_backup.items()}
    if allocation is None:
        return layout
    second = _make_answer_layout(1, steps, *allocation) if any(allocation) else {}
    of_second = {f"{ALLOCATION}{name}": array for name, array in second.items()}
    return layout | {"demand": ("f8", (steps, 3))} | of_second


def make_replay_layout(rounds: int, steps: int, n: int, m: int) -> Layout:
    """Return type and shape of every array that records a replay; round 0 is the warm-up."""
    return _make_answer_layout(rounds, steps, n, m) | {
        "reference_kernel_ns": ("f8", (rounds, 2)),
        "load_kernel_ns": ("f8", (rounds, 2, LOAD_PASSES)),
        "attempts": ("i8", (rounds,)),
        "first_ns": ("i8", (steps,)),
        "first_reference_kernel_ns": ("f8", (rounds,)),
        "counters": ("f8", (rounds, len(COUNTERS))),
        "energy_J": ("f8", (rounds,)),
        "footprint": ("f8", (len(FOOTPRINT),)),
    }


def _make_answer_layout(rounds: int, steps: int, n: int, m: int) -> Layout:
    """Return type and shape of the arrays that hold a solver's answers and times."""
    return {
        "done": ("i8", (rounds,)),
        "started": ("i8", (1,)),
        "setup_once_ns": ("i8", (1,)),
        "matrix_updates": ("i8", (rounds,)),
        "times": ("i8", (rounds, steps, len(PHASES))),
        "status": ("i8", (rounds, steps)),
        "iterations": ("i8", (rounds, steps)),
        "reported_ns": ("i8", (rounds, steps)),
        "waited_ns": ("i8", (rounds, steps)),
        "z": ("f8", (rounds, steps, n)),
        "y": ("f8", (rounds, steps, m)),
        "y_box": ("f8", (rounds, steps, n)),
    }


class AnswerLog:
    """Recorded answers of one solver: solution, times and status over (rounds, steps)."""

    done: Ints
    started: Ints
    setup_once_ns: Ints
    matrix_updates: Ints
    times: Ints
    status: Ints
    iterations: Ints
    reported_ns: Ints
    waited_ns: Ints
    z: Floats
    y: Floats
    y_box: Floats


class BackupLog(AnswerLog):
    """Recorded answers of the backup solver; all times are −1 in steps it did not solve.

    `acted` (steps,) whether its plan was applied, or began to be; `ready_ns` (steps,) time of its
    answer on a slow computer from t_k on, −1 where there is none.
    """

    acted: NDArray[np.uint8]
    ready_ns: Ints


class RawLog(AnswerLog):
    """The record of a run while it is made: arrays over steps in one buffer, mostly a file.

    `done[r]` counts the completed steps of round r and is written last. `flags` (steps, 3) has
    fallback, unconverged, clipped; `attempts[r]` the attempts of round r; `first_ns` (steps,) the
    time of the first visit of each step, −1 without a record; `first_reference_kernel_ns[r]` the
    larger reference time around the first attempt of round r; `energy_J[r]` the energy of the
    processor package in its steps (`energy.py`); `tau` the applied force and `thrust` the thruster
    forces, where they are commanded; `latency_ns` (steps,) is written by
    `slow_computer.py`. Of a cascade, `demand` (steps, 3) is the force demanded of the thrusters,
    and `allocation` has the answers to its second QP. `allocation` and `backup` are None where
    there is none.
    """

    theta: Floats
    state: Floats
    tau: Floats
    thrust: Floats
    demand: Floats
    command: Floats
    flags: NDArray[np.uint8]
    latency_ns: Ints
    reference_kernel_ns: Floats
    load_kernel_ns: Floats
    attempts: Ints
    first_ns: Ints
    first_reference_kernel_ns: Floats
    counters: Floats
    energy_J: Floats
    footprint: Floats

    def __init__(self, layout: Layout, buffer: Any) -> None:
        offset = 0
        self._buffer = buffer
        self.allocation = AnswerLog() if f"{ALLOCATION}z" in layout else None
        self.backup = BackupLog() if f"{BACKUP}z" in layout else None
        parts = {ALLOCATION: self.allocation, BACKUP: self.backup}
        for name, (dtype, shape) in layout.items():
            count = math.prod(shape)
            prefix = next((prefix for prefix in parts if name.startswith(prefix)), "")
            array = np.frombuffer(buffer, dtype, count, offset).reshape(shape)
            setattr(parts.get(prefix, self), name.removeprefix(prefix), array)
            offset += -(-count * np.dtype(dtype).itemsize // _ALIGN) * _ALIGN

    @classmethod
    def in_memory(cls, layout: Layout) -> "RawLog":
        """Return a new record of a run in this process's memory."""
        return cls(layout, bytearray(compute_log_bytes(layout)))

    @classmethod
    def create(cls, path: Path, layout: Layout) -> "RawLog":
        """Return a run's new record in a file of its full size; OSError where there is no room.

        It appears at `path` whole or not at all, as the supervisor may read it at any moment.
        Without all its room a later step would die by SIGBUS.
        """
        path.with_suffix(".layout").write_text(json.dumps(layout), encoding="ascii")
        blank = path.with_suffix(".blank")
        try:
            _allocate_file(blank, compute_log_bytes(layout))
            blank.replace(path)
        finally:
            blank.unlink(missing_ok=True)
        return cls.open(path)

    @classmethod
    def open(cls, path: Path) -> "RawLog":
        """Return a run's record in its file, writable and shared between processes."""
        layout = json.loads(path.with_suffix(".layout").read_text(encoding="ascii"))
        with path.open("r+b") as file:
            return cls(layout, mmap.mmap(file.fileno(), 0))

    def touch_pages(self) -> None:
        """Read a byte of every page of the record, so that the kernel maps them into memory."""
        np.frombuffer(self._buffer, np.uint8)[:: mmap.PAGESIZE].max(initial=0)


def sum_phases_by_step_ns(times: Ints) -> Ints:
    """Return each step's solver time [ns] (...) from the times of its phases (..., 6)."""
    total: Ints = np.maximum(times[..., _OWN], 0).sum(axis=-1)
    return total


def sum_phases_of_step_ns(phases_ns: Iterable[int]) -> int:
    """Return the sum of one step's solver phases [ns]; negative ones did not take place."""
    return sum(ns for ns in phases_ns if ns > 0)


def compute_log_bytes(layout: Layout) -> int:
    """Return the size [B] of the file that a run is recorded in, from its arrays' layout."""
    sizes = [math.prod(shape) * np.dtype(dtype).itemsize for dtype, shape in layout.values()]
    return sum(-(-size // _ALIGN) * _ALIGN for size in sizes)


def _allocate_file(path: Path, size: int) -> None:
    """Write a file of zeros with all its blocks allocated; OSError where there is no room."""
    with path.open("wb") as file:
        # A disk that allocates late says only now what it has no room for; some cannot say it.
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
                raise
        file.write(bytes(size))


def is_log_full_size_and_writable(path: Path) -> bool:
    """Return whether the file that a run is recorded in has its full size and can be written.

    Otherwise writing to it through memory is a SIGBUS. A file system that copies on write shows a
    lack of room only when written, so a byte of each page is rewritten.
    """
    try:
        layout = json.loads(path.with_suffix(".layout").read_text(encoding="ascii"))
        with path.open("r+b", buffering=0) as file:
            size = compute_log_bytes(layout)
            if os.fstat(file.fileno()).st_size != size:
                return False
            for at in range(0, size, mmap.PAGESIZE):
                os.pwrite(file.fileno(), os.pread(file.fileno(), 1, at), at)
    except (OSError, ValueError):
        return False
    return True


def delete_log_and_layout(path: Path) -> None:
    """Delete the file that a run was recorded in, and the file with its layout."""
    path.unlink(missing_ok=True)
    path.with_suffix(".layout").unlink(missing_ok=True)
