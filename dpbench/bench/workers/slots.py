"""The one loop that starts processes on cores, waits for them, and ends those that are overdue."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Protocol, TypeVar

from dpbench.bench.record.cell import Outcome
from dpbench.bench.workers.child import Child

POLL_S = 0.02


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


class Errand:
    """A task of one process that makes one file, and leaves no log.

    Parameters
    ----------
    target : called in the process as target(description, folder, name, core, path).
    folder, name : where the process leaves its noise and its verdict.
    path : the file it makes.
    limit_s : what it may take; None for any time.
    """

    def __init__(
        self,
        context: ForkServerContext,
        target: Callable[[str, Path, str, int, Path], None],
        description: str,
        folder: Path,
        path: Path,
        *,
        limit_s: float | None = None,
    ) -> None:
        self._context, self._target, self._description = context, target, description
        self._folder, self.path, self._limit_s = folder, path, limit_s
        self.outcome = Outcome("lost", "it was not run")

    def start(self, core: int) -> Child:
        """Its process."""
        name = self.path.stem
        args = (self._description, self._folder, name, core, self.path)
        limit_s = self._limit_s
        return Child(
            self._context, self._target, args, self._folder, name, limit_s=limit_s, logs=False
        )

    def follow(self, child: Child, core: int) -> None:
        """Keep what became of it."""
        self.outcome = child.outcome()
