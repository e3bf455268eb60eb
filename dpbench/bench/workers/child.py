"""Start a cell's process, watch its limits, and turn its end into an outcome."""

import json
import multiprocessing
import multiprocessing.forkserver
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from types import ModuleType
from typing import Any

from dpbench.bench.record.cell import Outcome
from dpbench.bench.record.machine import THREAD_VARIABLES, limit_libraries_to_one_thread
from dpbench.bench.record.raw_log import RawLog, is_log_full_size_and_writable
from dpbench.bench.run.footprint import process_peak_bytes
from dpbench.bench.run.timed_solver import read_process_wait_s
from dpbench.bench.workers import shared_status
from dpbench.bench.workers.interrupts import (
    block_sigint,
    delay_signals,
    start_resource_tracker,
)
from dpbench.bench.workers.orphans import END_S, end_orphans, kill_forkserver, signal_process
from dpbench.bench.workers.shared_status import CUT, Phase, SharedStatus
from dpbench.errors import DpbenchError
from dpbench.kernel_cache import list_numba_cache_folders
from dpbench.temporary_folders import place_sockets_in_process_folder

LOOP = "dpbench.bench.workers.template"
"""The module that compiles, as it is imported, what every cell needs."""
_LAST_COMPILED = "replay._reference_kernel-*.nbi"
"""The index in Numba's cache of what it compiles last."""


def has_compiled_kernels() -> bool:
    """Return whether Numba's cache on this machine holds all kernels, whatever cells will run."""
    return any(any(folder.rglob(_LAST_COMPILED)) for folder in list_numba_cache_folders())


START_ALLOWANCE_S = 60.0
"""Time allowed to import a library [s]; after it a cell that has not started its loop is killed."""
GRACE_S = 3.0
"""Time beyond a cell's own limit for one call that does not return [s]; for a round of a replay no
longer than the limit."""
LEAST_WAIT_S = 0.05
"""Least time between two looks at how long a process waited for its core [s]."""
STOPPED_S = 10.0  # A process that somebody stopped (SIGSTOP) is killed after this time
_BY_MEMORY = "killed by SIGKILL, probably by the out-of-memory killer"
FORKSERVER_DIED = Outcome(
    "lost", "its fork server was killed, probably by the out-of-memory killer"
)
KILLED_FORKSERVER = Outcome(
    "crashed", "the fork server was killed while it ran, and again while it ran alone"
)
_UNHEARD = 255  # The exit code that `multiprocessing` gives a process whose template died
STARTS = 3  # Attempts to start a process whose template is killed meanwhile
_DYING_S = 1.0  # For a process of which it is known that it was killed, until it is gone
_STARTING = threading.Lock()
"""Held while a process starts: what that changes for the moment is seen all over this one."""


KEEPER = "dpbench.bench.workers.keeper"
"""The module that puts a keeper above the template, before that loads anything."""


class NoProcessError(DpbenchError):
    """Raised where no worker process can be started any more."""


def start_forkserver() -> ForkServerContext:
    """Start the process that workers are forked from, code compiled; return its context."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([KEEPER, LOOP])
    with _running_forkserver():
        return context


@contextmanager
def _running_forkserver() -> Iterator[None]:
    """Start Python's fork server with one thread per library, and restore the environment after."""
    with _STARTING:
        before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
        limit_libraries_to_one_thread()
        try:
            start_resource_tracker()
            place_sockets_in_process_folder()
            # Until it has loaded, Ctrl-C would end the template with a traceback of its own.
            with block_sigint():
                multiprocessing.forkserver.ensure_running()
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


class Child:
    """A worker process, which records a run and writes its outcome, with limits on its time.

    target, args : called in the process as target(*args); it writes `verdict` before it ends, and
        sets its phase in `shared_status.py`. An end without a verdict is charged to that phase.
    folder, name : of its raw log and verdict.
    limit_s : run time after the start of its log, without waits for its core; None for no limit.
    logs : whether it leaves a raw log; otherwise its time runs from its start.
    forkserver_died : whether its template died before it, so that its end is unknown.
    alone : whether it runs while nothing else does, because an earlier template died.
    Raises NoProcessError : the system starts no process, nor a new template.
    """

    def __init__(
        self,
        context: ForkServerContext,
        target: Callable[..., None],
        args: tuple[Any, ...],
        folder: Path,
        name: str,
        *,
        limit_s: float | None,
        verdict: str = "json",
        logs: bool = True,
    ) -> None:
        self._name_files(folder, name, verdict)
        self._limit_s = limit_s
        self._born, self._memory_kills = time.monotonic(), _count_memory_kills()
        self._running_since = None if logs else self._born
        self._killed_for, self._was_killed = "", False
        self.forkserver_died, self.alone = False, False
        self._stopped_since: float | None = None
        self._peak_bytes = 0.0
        self.notice = SharedStatus()
        self.process: ForkServerProcess = context.Process(
            target=shared_status.run_target, args=(self.notice, target, args), daemon=True
        )
        _start_process(self.process)
        self.notice.close_descriptor()

    def _name_files(self, folder: Path, name: str, verdict: str) -> None:
        """Store the names of a process's files, make their folder, and remove an old verdict."""
        self.folder, self.name = folder, name
        # Somebody else may have removed the folder, which costs those that had files in it.
        folder.mkdir(0o700, parents=True, exist_ok=True)
        self._verdict = folder / f"{name}.{verdict}"
        self._verdict.unlink(missing_ok=True)

    @property
    def raw_path(self) -> Path:
        """Path of the raw log, which exists once the run has started."""
        return self.folder / f"{self.name}.raw"

    @property
    def has_verdict(self) -> bool:
        """Return whether the worker process wrote its outcome, which is final."""
        return self._verdict.exists()

    @property
    def is_suspect(self) -> bool:
        """Return whether the worker may have killed its parent, so that it must run again alone."""
        return self.forkserver_died and not self.alone

    def kill_if_overdue(self) -> bool:
        """Kill the process where a time limit has passed; return whether it was killed."""
        now = time.monotonic()
        self._peak_bytes = max(self._peak_bytes, self._read_peak_bytes())
        if self._is_stopped_too_long(now):
            return self.kill(f"it was stopped by a signal for {STOPPED_S:g} s and was killed")
        if self._running_since is None and self._has_started():
            self._running_since = now
        if self._running_since is None:
            if now - self._born > START_ALLOWANCE_S:
                return self.kill(f"did not start within {START_ALLOWANCE_S:g} s")
        elif self._limit_s is not None and self._is_overdue(now - self._running_since):
            return self.kill(f"one call ran beyond the limit of {self._limit_s:g} s and was killed")
        return False

    def _is_overdue(self, running_s: float) -> bool:
        """Return whether the run time, without waits for the core, is beyond its limit."""
        most_s = (self._limit_s or 0.0) + GRACE_S
        return running_s > most_s and running_s - self._read_wait_s() > most_s

    def _read_wait_s(self) -> float:
        """Return how long the process has waited for its core so far [s]; 0 where unknown."""
        return read_process_wait_s(self.process.pid or 0)

    def _read_peak_bytes(self) -> float:
        """Return the peak memory of the process so far [B]; 0 where it is gone."""
        peak = process_peak_bytes(self.process.pid or 0)
        return peak if peak == peak else 0.0

    def _is_stopped_too_long(self, now: float) -> bool:
        """Return whether a signal has kept the process stopped for longer than `STOPPED_S`."""
        if not is_stopped(self.process.pid or 0):
            self._stopped_since = None
        elif self._stopped_since is None:
            self._stopped_since = now
        return self._stopped_since is not None and now - self._stopped_since > STOPPED_S

    def kill(self, reason: str) -> bool:
        """Kill the process and note the reason for its outcome; return True."""
        self._peak_bytes = max(self._peak_bytes, self._read_peak_bytes())
        self._killed_for, self._was_killed = reason, True
        self.process.kill()
        self._join_process()
        return True

    def _join_process(self) -> None:
        """Wake the worker's parent, which may be stopped, and wait for the end of the worker."""
        # A stopped template does not say who ended, and a stopped keeper does not let it go on.
        signal_process(self.notice.page.keeper, signal.SIGCONT)
        self.process.join()

    def join(self) -> None:
        """Wait for the end of the process, and end the processes that it has started."""
        self._join_process()
        end_orphans(self.notice.page.keeper, self.notice.page.forkserver)
        if self.forkserver_died or self.process.exitcode != _UNHEARD:
            return
        self.forkserver_died = _wait_for_end(self.notice.page.forkserver)
        if self.forkserver_died and self.process.pid is not None:
            _kill_and_wait(self.process.pid)

    def _has_started(self) -> bool:
        """Return whether the run has started, by its raw log."""
        try:
            return bool(RawLog.open(self.raw_path).started[0])
        except (OSError, ValueError):
            return False

    def determine_outcome(self) -> Outcome:
        """Wait for the end of the process; return its outcome as written, or from its exit code."""
        self.join()
        # Its solver may end it in untimed steps behind its verdict.
        by_itself = self.notice.phase is Phase.SOLVER and not self._was_killed
        if self.has_verdict and (self.forkserver_died or not by_itself):
            return self.read_verdict(self._verdict)
        if self.forkserver_died:
            guilty = self.alone and self.notice.phase.blames_solver
            return KILLED_FORKSERVER if guilty else FORKSERVER_DIED
        ended = self._diagnose_end()
        cut = f"; {CUT}" if self.notice.output.is_full else ""
        peak = max(self._peak_bytes, self.notice.page.peak_bytes)
        return replace(ended, detail=f"{ended.detail}{cut}", peak_bytes=peak or None)

    def _diagnose_end(self) -> Outcome:
        """Return the outcome of a worker that wrote none, by its exit code and what it was at."""
        by_solver = self.notice.phase.blames_solver
        if self._killed_for and self.notice.phase is Phase.PLANT:
            return self._blame_plant(self._killed_for)
        if self._killed_for:
            return Outcome("hung" if by_solver else "lost", self._killed_for)
        code = self.process.exitcode or 0
        if -code == signal.SIGKILL and self._memory_ran_out():
            return Outcome("lost", _BY_MEMORY)
        if (
            -code == signal.SIGBUS
            and self.raw_path.exists()
            and not is_log_full_size_and_writable(self.raw_path)
        ):
            return Outcome("lost", "killed by SIGBUS: its log lost its space on the file system")
        if by_solver:
            return Outcome("crashed", self._describe_end(code))
        if self.notice.phase is Phase.PLANT:
            return self._blame_plant(self._describe_end(code))
        if not self.folder.exists():
            return Outcome("lost", f"its scratch folder {self.folder} was removed")
        return Outcome("lost", self._describe_end(code))

    def _blame_plant(self, reason: str) -> Outcome:
        """Return the outcome of a run that its FMU ended; it counts against no solver."""
        fmu = self.notice.page.fmu.decode(errors="replace")
        return Outcome("invalid", f"plant {fmu} failed, not the solver: {reason}")

    def _memory_ran_out(self) -> bool:
        """Return whether the kernel killed processes for lack of memory, or hides that."""
        now = _count_memory_kills()
        return now is None or now != self._memory_kills

    def _describe_end(self, code: int) -> str:
        """Return why the process ended, in words, from its exit code and last output."""
        if -code == signal.SIGALRM and self.notice.phase is Phase.PLANT:
            return "one call ran beyond the limit of a cell and was ended"
        if code < 0:
            return f"killed by {_signal_name(-code)}"
        words = self.notice.exit_reason
        if not words:
            last = self.notice.output.last_line or "no output"
            words = f"its process left with exit code {code}: {last}"
        where = " while it was opened" if self.notice.phase is Phase.OPENING else ""
        return f"{words}{where}"

    @staticmethod
    def read_verdict(path: Path) -> Outcome:
        """Return the outcome that a worker wrote to a file; "lost" where it cannot be read."""
        try:
            return Outcome(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError) as error:
            return Outcome("lost", f"its outcome cannot be read: {error}")


class ServingChild(Child):
    """A worker process that takes orders over a pipe and may do several runs in turn.

    `begin_cell` begins each cell but the first, `finish_cell` ends each; None ends the process.
    """

    def __init__(
        self,
        context: ForkServerContext,
        target: Callable[..., None],
        args: tuple[Any, ...],
        folder: Path,
        name: str,
        *,
        limit_s: float | None,
    ) -> None:
        self._orders, far_end = context.Pipe()
        super().__init__(context, target, (*args, far_end), folder, name, limit_s=limit_s)
        far_end.close()

    def send_order(self, order: object) -> None:
        """Send an order to the worker process; one that died is noticed at the reply."""
        with suppress(OSError):
            self._orders.send(order)

    def wait_until_ready(self) -> object:
        """Return the worker's first reply, within the time to start; None where it died."""
        return self._receive_reply(
            START_ALLOWANCE_S, f"did not start within {START_ALLOWANCE_S:g} s"
        )

    def wait_for_reply(self, limit_s: float) -> object:
        """Return the worker's next reply; None where it died, refused, or hung and was killed."""
        return self._receive_reply(
            limit_s + min(GRACE_S, limit_s), f"one call ran beyond the limit of {limit_s:g} s"
        )

    def _receive_reply(self, wait_s: float, overdue: str) -> object:
        """Return the worker's reply if it comes within `wait_s`; else kill it and return None."""
        begun_s, waited_s, left_s = time.monotonic(), self._read_wait_s(), wait_s
        # What the process started may hold the other end of its pipe open when it ends.
        while not (ready := wait([self._orders, self.process.sentinel], left_s)):
            # What it waited for its core is no time of its own.
            used_s = time.monotonic() - begun_s - (self._read_wait_s() - waited_s)
            if used_s >= wait_s:
                break
            left_s = max(wait_s - used_s, LEAST_WAIT_S)
        try:
            if ready:
                return self._orders.recv() if self._orders.poll() else None
        except (EOFError, OSError):
            return None
        self.kill(f"{overdue} and was killed")
        return None

    def begin_cell(self, folder: Path, name: str) -> None:
        """Begin another run in this process, with its own folder, log and outcome file."""
        self._peak_bytes = 0.0
        self._name_files(folder, name, "json")

    def finish_cell(self) -> Outcome:
        """End the current run and return its outcome; kill the process if it does not reply."""
        self.send_order(None)
        if self._receive_reply(GRACE_S, "did not end on request") is True:
            return self.read_verdict(self._verdict)
        return self.determine_outcome()

    def dismiss(self) -> Outcome:
        """End the process, by force if need be, and return its outcome."""
        self.send_order(None)
        self.process.join(GRACE_S)
        if self.process.is_alive():
            # Behind its verdict a worker only counts allocations, which is no reason to blame it.
            self.kill("" if self.has_verdict else "did not end on request")
        self._orders.close()
        return self.determine_outcome()


# A signal that ended a start half-way would leave a process to complain of an empty pipe.
@delay_signals()
def _start_process(process: ForkServerProcess) -> None:
    """Start a worker process, again where its parent dies; NoProcessError after `STARTS` times."""
    for attempt in range(STARTS):
        # Nobody else lets a stopped keeper go on, and only that a stopped template.
        signal_process(_find_keeper_pid(), signal.SIGCONT)
        try:
            with _running_forkserver(), hide_main_module():
                process.start()
            return
        except (OSError, EOFError) as error:
            if attempt == STARTS - 1:
                why = f"no process can be started any more ({error!r})"
                raise NoProcessError(f"{why}; finished cells are kept") from error
            # It may have forked the process and not lived to tell: that ends with it.
            kill_forkserver(_find_keeper_pid())
            # While the old one lives the next attempt gets no other template, and fails as well.
            if not _wait_for_end(_find_keeper_pid(), END_S):
                _kill_and_wait(_find_keeper_pid())


def _find_keeper_pid() -> int:
    """Return the id of the process that watches over the one workers are forked from; 0 if none."""
    server = multiprocessing.forkserver._forkserver
    return server._forkserver_pid or 0  # type: ignore[attr-defined] # not public


def is_stopped(pid: int) -> bool:
    """Return whether a signal has stopped a process (proc(5))."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] == "T"


def _kill_and_wait(pid: int) -> None:
    """Kill a process and wait for its end."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    _wait_for_end(pid)


def _wait_for_end(pid: int, wait_s: float = _DYING_S) -> bool:
    """Wait up to `wait_s` for a process to end; return whether it did."""
    try:
        process = os.pidfd_open(pid)
    except OSError:
        return True
    try:
        return bool(wait([process], wait_s))
    finally:
        os.close(process)


@contextmanager
def hide_main_module() -> Iterator[None]:
    """Hide the main program from processes started in the block, which would run it again."""
    program = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = program


def _signal_name(number: int) -> str:
    """Return the name of a signal by its number."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _count_memory_kills() -> int | None:
    """Return how many processes the kernel has killed for memory; None where it hides that."""
    try:
        lines = Path("/proc/vmstat").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), None)
