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


Entry = tuple[AnyTask, Child, int]
"""A task, its process, and the core of that."""


def in_slots(tasks: Sequence[AnyTask], cores: Sequence[int]) -> Iterator[AnyTask]:
    """Run tasks, as many at a time as there are `cores`, each on one of them.

    All that were at work when their template ended are suspected of having ended it. Each goes on
    while nothing else runs, so that whoever ends the next one is known.

    Yields
    ------
    Each task when it has come to its end.
    """
    waiting, free = list(reversed(tasks)), list(cores)
    running: list[Entry[AnyTask]] = []
    ended: list[Entry[AnyTask]] = []
    while waiting or running or ended:
        for entry in _due(ended, running):
            ended.remove(entry)
            task, child, core = entry
            following = task.follow(child, core)
            if following is None:
                free.append(core)
                yield task
            else:
                running.append((task, following, core))
        while waiting and free and not ended and not _any_alone(running):
            task, core = waiting.pop(), free.pop()
            running.append((task, task.start(core), core))
        wait([child.process.sentinel for _, child, _ in running], POLL_S if running else 0.0)
        for entry in list(running):
            _, child, _ = entry
            if child.process.is_alive() and not child.overdue():
                continue
            child.join()
            running.remove(entry)
            ended.append(entry)


def _due(ended: list[Entry[AnyTask]], running: list[Entry[AnyTask]]) -> list[Entry[AnyTask]]:
    """Those of which the next process may start now."""
    if _any_alone(running):
        return []
    suspects = [entry for entry in ended if entry[1].is_suspect]
    if not suspects:
        return list(ended)
    return [] if running else suspects[:1]


def _any_alone(running: list[Entry[AnyTask]]) -> bool:
    return any(child.alone for _, child, _ in running)
