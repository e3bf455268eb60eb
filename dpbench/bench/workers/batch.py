"""Cells of one configuration one after the other in one process, then judged one after the other.

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
from dpbench.bench.workers.worker import BatchCell, evaluate_batch, run_replay_batch

GRADING_LIMIT_S = 600.0


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
        limit_s: float,
        verdict: str,
    ) -> None:
        self._cells, self._suffix, self._at = list(cells), verdict, 0
        args = (tuple(cells), folder, core)
        for cell in cells:
            (folder / f"{cell.name}.{verdict}").unlink(missing_ok=True)
        super().__init__(
            context, target, args, folder, cells[0].name, limit_s=limit_s, verdict=verdict
        )

    def _follow(self) -> None:
        """Watch the first cell that has no verdict yet."""
        while self._at < len(self._cells) and self._verdict.exists():
            self._at += 1
            if self._at < len(self._cells):
                self.name = self._cells[self._at].name
                self._verdict = self.folder / f"{self.name}.{self._suffix}"
                self._born, self._running_since = time.monotonic(), None

    def overdue(self) -> bool:
        self._follow()
        return self._at < len(self._cells) and super().overdue()

    def split(self) -> tuple[dict[str, Outcome], list[BatchCell]]:
        """Once the process ended: what became of the cells it came to, and those still to do."""
        self.process.join()
        self._follow()
        found = {}
        for cell in self._cells[: self._at]:
            found[cell.name] = self.verdict_of(self.folder / f"{cell.name}.{self._suffix}")
        # A library may bring its process down when it is let go, between two cells.
        not_begun = self._at > 0 and self.notice.place < self._at
        if not_begun or self._at == len(self._cells):
            return found, self._cells[self._at :]
        found[self.name] = self.outcome()
        return found, self._cells[self._at + 1 :]


class CellBatch:
    """All cells of one configuration on their way: replayed, then judged.

    Parameters
    ----------
    cells : what the worker needs of each cell, in order; limit_s : a cell's own run time.
    """

    def __init__(
        self, context: ForkServerContext, folder: Path, cells: Sequence[BatchCell], limit_s: float
    ) -> None:
        self._context, self._folder, self._cells = context, folder, list(cells)
        self._limit_s = limit_s
        self._judging = False
        self.outcomes: dict[str, Outcome] = {}

    def start(self, core: int) -> Child:
        """The first process."""
        return self._replay(self._cells, core)

    def evaluate(self, core: int) -> Child:
        """The first process where all cells were replayed before, and left steps."""
        self._judging = True
        return self._evaluate(self._cells, core)

    def follow(self, child: Child, core: int) -> Child | None:
        """Take down what became of the process that ended; the next one, or None at the end."""
        assert isinstance(child, _Run), "the processes of a batch are its own"
        found, rest = child.split()
        if not self._judging:
            self.outcomes |= found
            if rest:
                return self._replay(rest, core)
            self._judging = True
            for cell in self._cells:
                self.outcomes[cell.name] = with_log(self.outcomes[cell.name], self._raw(cell))
            rest = [cell for cell in self._cells if self._left_steps(cell)]
        else:
            for name, verdict in found.items():
                if verdict.outcome != "finished":
                    self.outcomes[name] = not_evaluated(verdict)
        return self._evaluate(rest, core) if rest else None

    def _raw(self, cell: BatchCell) -> Path:
        return self._folder / f"{cell.name}.raw"

    def _left_steps(self, cell: BatchCell) -> bool:
        return self.outcomes[cell.name].outcome != "lost" and self._raw(cell).exists()

    def _replay(self, cells: Sequence[BatchCell], core: int) -> Child:
        return _Run(
            self._context,
            run_replay_batch,
            cells,
            self._folder,
            core,
            limit_s=self._limit_s,
            verdict="json",
        )

    def _evaluate(self, cells: Sequence[BatchCell], core: int) -> Child:
        return _Run(
            self._context,
            evaluate_batch,
            cells,
            self._folder,
            core,
            limit_s=GRADING_LIMIT_S,
            verdict="evaluated.json",
        )


def not_evaluated(found: Outcome) -> Outcome:
    """What becomes of a cell on which the referee's process ended so."""
    return Outcome("lost", f"the referee failed on it: {found.detail}")


def configuration_of(cell: Cell) -> tuple[str, ...]:
    """Cells with the same configuration may share a process."""
    return (cell.solver, cell.route, cell.policy, cell.settings, cell.formulation, cell.units)
