"""Start a cell's process, watch its limit, and turn whatever becomes of it into an outcome."""

from __future__ import annotations

import json
import multiprocessing
import multiprocessing.forkserver
import multiprocessing.resource_tracker
import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from typing import Any, TypeVar

from dpbench.bench.interrupts import interrupts_wait
from dpbench.bench.machine import THREAD_VARIABLES, pin_threads
from dpbench.bench.rawlog import RawLog

START_ALLOWANCE_S = 60.0
"""For importing a library; after it a cell that has not started its loop is killed."""
GRACE_S = 3.0
"""Beyond a cell's own limit, for one call that does not return."""
POLL_S = 0.02
Task = TypeVar("Task")


@dataclass(frozen=True)
class Outcome:
    """What became of a process: `outcome` as in `runs.parquet`, its cause, the solver's form.

    n, m : size of the QP the solver was given; None where it never got one.
    """

    outcome: str
    detail: str
    form: str = ""
    n: int | None = None
    m: int | None = None


def template_context() -> ForkServerContext:
    """The context whose processes are forked from the template (`template.py`), threads pinned."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["dpbench.bench.template"])
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    pin_threads()
    try:
        # This lets Ctrl-C through when it starts its own process, and does nothing the second time.
        multiprocessing.resource_tracker.ensure_running()
        # Until it has loaded, Ctrl-C would end the template with a traceback of its own.
        with interrupts_wait():
            multiprocessing.forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
    return context


class Child:
    """One process with a working folder.

    Parameters
    ----------
    target, args : called in the process as target(*args); it writes `verdict` before it ends.
    folder, name : where its raw log, noise and verdict appear.
    limit_s : own run time allowed once its log says it started; None for none.
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
    ) -> None:
        self.folder, self.name = folder, name
        self._verdict, self._noise = folder / f"{name}.{verdict}", folder / f"{name}.noise"
        self._limit_s = limit_s
        self._born = time.monotonic()
        self._running_since: float | None = None
        self._killed_for = ""
        self.process: ForkServerProcess = context.Process(target=target, args=args, daemon=True)
        self.process.start()

    @property
    def raw_path(self) -> Path:
        """Its raw log; there is none before it started."""
        return self.folder / f"{self.name}.raw"

    @property
    def has_verdict(self) -> bool:
        """Whether it wrote what became of it; what it does after that changes nothing."""
        return self._verdict.exists()

    def overdue(self) -> bool:
        """Kill the process when a limit has passed; true if it did."""
        now = time.monotonic()
        if self._running_since is None and self._has_started():
            self._running_since = now
        if self._running_since is None:
            if now - self._born > START_ALLOWANCE_S:
                return self.kill(f"did not start within {START_ALLOWANCE_S:g} s")
        elif self._limit_s is not None and now - self._running_since > self._limit_s + GRACE_S:
            return self.kill(f"one call ran beyond the limit of {self._limit_s:g} s and was killed")
        return False

    def kill(self, reason: str) -> bool:
        """Kill the process for a stated reason."""
        self._killed_for = reason
        self.process.kill()
        self.process.join()
        return True

    def _has_started(self) -> bool:
        return self.raw_path.exists() and bool(RawLog.open(self.raw_path).started[0])

    def outcome(self) -> Outcome:
        """What became of it, once it ended."""
        self.process.join()
        if self._killed_for:
            return Outcome("timed_out", self._killed_for)
        code = self.process.exitcode
        if self.has_verdict:
            return self.verdict_of(self._verdict)
        if code is not None and code < 0:
            return Outcome("crashed", f"killed by {signal.Signals(-code).name}")
        return Outcome("crashed", f"exit code {code}: {self._last_words()}")

    @staticmethod
    def verdict_of(path: Path) -> Outcome:
        """What the process wrote about a cell."""
        return Outcome(**json.loads(path.read_text(encoding="utf-8")))

    def _last_words(self) -> str:
        if not self._noise.exists():
            return "no output"
        lines = self._noise.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1][:300] if lines else "no output"


def in_slots(
    tasks: Sequence[Task],
    cores: Sequence[int],
    start: Callable[[Task, int], Child],
    ended: Callable[[Task, Child, int], Child | None],
) -> None:
    """Run a process per task, as many at a time as there are `cores`, each on one of them.

    `ended` may return another process that goes on with the task on the same core.
    """
    waiting, free = list(reversed(tasks)), list(cores)
    running: list[tuple[Task, Child, int]] = []
    while waiting or running:
        while waiting and free:
            task, core = waiting.pop(), free.pop()
            running.append((task, start(task, core), core))
        wait([child.process.sentinel for _, child, _ in running], POLL_S)
        for entry in list(running):
            task, child, core = entry
            if child.process.is_alive() and not child.overdue():
                continue
            running.remove(entry)
            following = ended(task, child, core)
            if following is None:
                free.append(core)
            else:
                running.append((task, following, core))
