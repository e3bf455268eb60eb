"""Cells of one configuration one after the other in one process, then judged one after the other.

Importing a library takes up to most of a second, and so it is for a batch where its cells take some
milliseconds each. Nothing of a batch is compared by its times: only replays are, each in a process
of its own (`interleaved.py`). A cell that crashes or hangs costs only itself; those after it go on
in a new process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.record.cell import Outcome
from dpbench.bench.workers.child import Child, with_log
from dpbench.bench.workers.worker import BatchCell, evaluate_batch, run_batch

EVALUATION_LIMIT_S = 600.0


class _Run(Child):
    """One process that goes through cells in order, each with a verdict of its own."""

    def __init__(
        self,
        context: ForkServerContext,
        target: Callable[..., None],
        cells: Sequence[BatchCell],
        folder: Path,
        core: int,
        *,
        verdict: str,
    ) -> None:
        self._cells, self._suffix, self._at = list(cells), verdict, 0
        args = (tuple(cells), folder, core)
        for cell in cells:
            (folder / f"{cell.name}.{verdict}").unlink(missing_ok=True)
        first, limit_s = cells[0].name, cells[0].limit_s
        super().__init__(context, target, args, folder, first, limit_s=limit_s, verdict=verdict)

    def _advance(self) -> None:
        """Watch the first cell that has no verdict yet."""
        while self._at < len(self._cells) and self._verdict.exists():
            self._at += 1
            if self._at < len(self._cells):
                self.name = self._cells[self._at].name
                self._limit_s = self._cells[self._at].limit_s
                self._verdict = self.folder / f"{self.name}.{self._suffix}"
                self._born, self._running_since = time.monotonic(), None

    def overdue(self) -> bool:
        self._advance()
        return self._at < len(self._cells) and super().overdue()

    def split(self) -> tuple[dict[str, Outcome], list[BatchCell]]:
        """Once the process ended: what became of the cells it came to, and those still to do."""
        self.process.join()
        self._advance()
        outcomes = {}
        for cell in self._cells[: self._at]:
            outcomes[cell.name] = self.verdict_of(self.folder / f"{cell.name}.{self._suffix}")
        # A library may bring its process down when it is let go, between two cells.
        not_begun = self._at > 0 and self.notice.place < self._at
        if not_begun or self._at == len(self._cells):
            return outcomes, self._cells[self._at :]
        outcomes[self.name] = self.outcome()
        return outcomes, self._cells[self._at + 1 :]


class CellBatch:
    """All cells of one configuration on their way: run, then judged.

    Parameters
    ----------
    cells : what the worker needs of each cell, in order.
    to_run : whether they are to be run; where not, they were before, and left steps.
    """

    def __init__(
        self,
        context: ForkServerContext,
        folder: Path,
        cells: Sequence[BatchCell],
        *,
        to_run: bool = True,
    ) -> None:
        self._context, self._folder, self._cells = context, folder, list(cells)
        self._to_run = to_run
        self.outcomes: dict[str, Outcome] = {}

    def start(self, core: int) -> Child:
        """The first process."""
        return self._process(self._cells, core)

    def follow(self, child: Child, core: int) -> Child | None:
        """Take down what became of the process that ended; the next one, or None at the end."""
        assert isinstance(child, _Run), "the processes of a batch are its own"
        ended, rest = child.split()
        if self._to_run:
            self.outcomes |= ended
            if not rest:
                self._to_run = False
                ran = [cell for cell in self._cells if self._left_steps(cell)]
                rest = [replace(cell, outcome=self.outcomes[cell.name]) for cell in ran]
        else:
            for name, verdict in ended.items():
                if verdict.outcome != "finished":
                    detail = f"the referee failed on it: {verdict.detail}"
                    self.outcomes[name] = Outcome("lost", detail)
        return self._process(rest, core) if rest else None

    def _left_steps(self, cell: BatchCell) -> bool:
        """Whether there is something to judge; a log that went away costs its cell."""
        raw = self._folder / f"{cell.name}.raw"
        outcome = self.outcomes[cell.name] = with_log(self.outcomes[cell.name], raw)
        return outcome.outcome != "lost" and raw.exists()

    def _process(self, cells: Sequence[BatchCell], core: int) -> Child:
        """A process that runs cells, or judges them when all are run."""
        target, verdict = run_batch, "json"
        if not self._to_run:
            target, verdict = evaluate_batch, "evaluated.json"
            cells = [replace(cell, limit_s=EVALUATION_LIMIT_S) for cell in cells]
        return _Run(self._context, target, cells, self._folder, core, verdict=verdict)
