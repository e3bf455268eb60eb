"""The one loop that starts processes on cores, waits for them, and ends those that are overdue."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from multiprocessing.connection import wait
from typing import Protocol, TypeVar

from dpbench.bench.workers.child import Child

POLL_S = 0.1
"""The end of a process is heard at once; this is for what takes too long."""


class Task(Protocol):
    """What takes one process, or several one after the other on the same core."""

    def start(self, core: int) -> Child:
        """Its first process."""

    def follow(self, child: Child, core: int) -> Child | None:
        """Take down what became of a process that ended; the next one, or None at the end."""


AnyTask = TypeVar("AnyTask", bound=Task)


def in_slots(tasks: Sequence[AnyTask], cores: Sequence[int]) -> Iterator[AnyTask]:
    """Run tasks, as many at a time as there are `cores`, each on one of them.

    Yields
    ------
    Each task when it has come to its end.
    """
    waiting, free = list(reversed(tasks)), list(cores)
    running: list[tuple[AnyTask, Child, int]] = []
    while waiting or running:
        while waiting and free:
            task, core = waiting.pop(), free.pop()
            running.append((task, task.start(core), core))
        wait([child.process.sentinel for _, child, _ in running], POLL_S)
        for entry in list(running):
            task, child, core = entry
            if child.process.is_alive() and not child.overdue():
                continue
            running.remove(entry)
            following = task.follow(child, core)
            if following is None:
                free.append(core)
                yield task
            else:
                running.append((task, following, core))
