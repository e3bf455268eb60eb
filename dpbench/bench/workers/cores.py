"""The loop that starts processes on cores, waits for them, and ends overdue ones."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing.connection import wait
from typing import Generic, Protocol, TypeVar

from dpbench.bench.workers.child import Child

POLL_S = 0.1
"""The end of a process is noticed at once; this is for what takes too long."""


class Task(Protocol):
    """A sequence of processes on one core."""

    def start(self, core: int) -> Child:
        """Start its first process."""

    def follow(self, child: Child, core: int) -> Child | None:
        """Record the outcome of a process; start the next one, or return None at the end."""


AnyTask = TypeVar("AnyTask", bound=Task)


class CorePool(Generic[AnyTask]):
    """Cores that run tasks, each one at a time."""

    def __init__(self, cores: Sequence[int]) -> None:
        self._free = list(cores)
        self._waiting = deque[AnyTask]()
        self._running: list[tuple[AnyTask, Child, int]] = []

    def __len__(self) -> int:
        return len(self._waiting) + len(self._running)

    def add(self, task: AnyTask) -> None:
        """Run a task when a core is free."""
        self._waiting.append(task)

    def completed(self) -> Iterator[AnyTask]:
        """Wait until a task has ended, if there is any; yield those that have."""
        ended: list[AnyTask] = []
        while len(self) and not ended:
            while self._waiting and self._free:
                task, core = self._waiting.popleft(), self._free.pop()
                self._running.append((task, task.start(core), core))
            wait([child.process.sentinel for _, child, _ in self._running], POLL_S)
            for entry in list(self._running):
                task, child, core = entry
                if child.process.is_alive() and not child.overdue():
                    continue
                child.join()
                self._running.remove(entry)
                following = task.follow(child, core)
                if following is None:
                    self._free.append(core)
                    ended.append(task)
                else:
                    self._running.append((task, following, core))
        yield from ended


def run_on_cores(tasks: Sequence[AnyTask], cores: Sequence[int]) -> Iterator[AnyTask]:
    """Run tasks, each on one core; yield each when it has ended."""
    pool = CorePool[AnyTask](cores)
    for task in tasks:
        pool.add(task)
    while len(pool):
        yield from pool.completed()
