"""Cells of one arm one after the other in one process, then judged one after the other.

For random problems, which ask whether an answer is true and not how long it took: importing a
library takes most of a second, replaying a small sequence some milliseconds. A cell that crashes
or hangs costs only itself; those after it go on in a new process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.workers.child import Child, with_log
from dpbench.bench.workers.worker import Link, grade_chain, run_replay_chain

GRADING_LIMIT_S = 600.0


class _Run(Child):
    """One process that goes through links in order, each with a verdict of its own."""

    def __init__(
        self,
        context: ForkServerContext,
        target: Callable[..., None],
        links: Sequence[Link],
        folder: Path,
        core: int,
        *,
        limit_s: float,
        verdict: str,
    ) -> None:
        self._links, self._suffix, self._at = list(links), verdict, 0
        args = (tuple(links), folder, core)
        for link in links:
            (folder / f"{link.name}.{verdict}").unlink(missing_ok=True)
        super().__init__(
            context, target, args, folder, links[0].name, limit_s=limit_s, verdict=verdict
        )

    def _follow(self) -> None:
        """Watch the first link that has no verdict yet."""
        while self._at < len(self._links) and self._verdict.exists():
            self._at += 1
            if self._at < len(self._links):
                self.name = self._links[self._at].name
                self._verdict = self.folder / f"{self.name}.{self._suffix}"
                self._born, self._running_since = time.monotonic(), None

    def overdue(self) -> bool:
        self._follow()
        return self._at < len(self._links) and super().overdue()

    def split(self) -> tuple[dict[str, Outcome], list[Link]]:
        """Once the process ended: what became of the links it came to, and those still to do."""
        self.process.join()
        self._follow()
        found = {}
        for link in self._links[: self._at]:
            found[link.name] = self.verdict_of(self.folder / f"{link.name}.{self._suffix}")
        # A library may bring its process down when it is let go, between two cells.
        not_begun = self._at > 0 and self.notice.link < self._at
        if not_begun or self._at == len(self._links):
            return found, self._links[self._at :]
        found[self.name] = self.outcome()
        return found, self._links[self._at + 1 :]


class Chain:
    """All cells of one arm on their way: replayed, then judged.

    Parameters
    ----------
    links : what the worker needs of each cell, in order; limit_s : a cell's own run time.
    """

    def __init__(
        self, context: ForkServerContext, folder: Path, links: Sequence[Link], limit_s: float
    ) -> None:
        self._context, self._folder, self._links = context, folder, list(links)
        self._limit_s = limit_s
        self._judging = False
        self.outcomes: dict[str, Outcome] = {}

    def start(self, core: int) -> Child:
        """The first process."""
        return self._replay(self._links, core)

    def judge(self, core: int) -> Child:
        """The first process where all cells were replayed before, and left steps."""
        self._judging = True
        return self._judge(self._links, core)

    def follow(self, child: Child, core: int) -> Child | None:
        """Take down what became of the process that ended; the next one, or None at the end."""
        assert isinstance(child, _Run), "the processes of a chain are its own"
        found, rest = child.split()
        if not self._judging:
            self.outcomes |= found
            if rest:
                return self._replay(rest, core)
            self._judging = True
            for link in self._links:
                self.outcomes[link.name] = with_log(self.outcomes[link.name], self._raw(link))
            rest = [link for link in self._links if self._left_steps(link)]
        else:
            for name, verdict in found.items():
                if verdict.outcome != "finished":
                    self.outcomes[name] = not_judged(verdict)
        return self._judge(rest, core) if rest else None

    def _raw(self, link: Link) -> Path:
        return self._folder / f"{link.name}.raw"

    def _left_steps(self, link: Link) -> bool:
        return self.outcomes[link.name].outcome != "lost" and self._raw(link).exists()

    def _replay(self, links: Sequence[Link], core: int) -> Child:
        return _Run(
            self._context,
            run_replay_chain,
            links,
            self._folder,
            core,
            limit_s=self._limit_s,
            verdict="json",
        )

    def _judge(self, links: Sequence[Link], core: int) -> Child:
        return _Run(
            self._context,
            grade_chain,
            links,
            self._folder,
            core,
            limit_s=GRADING_LIMIT_S,
            verdict="graded.json",
        )


def not_judged(found: Outcome) -> Outcome:
    """What becomes of a cell on which the referee's process ended so."""
    return Outcome("lost", f"the referee failed on it: {found.detail}")


def arm_of(cell: Cell) -> tuple[str, ...]:
    """Cells with the same arm may share a process."""
    return (cell.solver, cell.route, cell.policy, cell.settings, cell.formulation, cell.units)
