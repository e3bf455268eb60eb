"""Cells of one configuration in one process, one after the other, then judged likewise.

Importing a library takes up to most of a second, cells of a batch some milliseconds each. Their
times are not compared: only replays are (`interleaved.py`). A cell that crashes costs only itself,
and one that hangs only that step where it can go on behind it; the rest go on in a new process.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Generic, TypeVar

from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import delete_log_and_layout
from dpbench.bench.record.step_table import DAMAGE, BatchPart, parse_batch_part
from dpbench.bench.workers.child import GRACE_S, Child
from dpbench.bench.workers.jobs import CellBatch, FileBatch, Result, Target
from dpbench.bench.workers.shared_status import Phase, set_phase
from dpbench.bench.workers.worker import BatchCell, evaluate_batch, find_hang, run_batch

EVALUATION_LIMIT_S = 600.0


AnyItem = TypeVar("AnyItem", "BatchCell", "FileTask")


class _ItemProcess(Child, Generic[AnyItem]):
    """A worker process that does several runs or files in order, with an outcome file for each."""

    def __init__(
        self,
        context: ForkServerContext,
        target: Callable[..., None],
        items: Sequence[AnyItem],
        folder: Path,
        core: int,
        *,
        verdict: str = "json",
        logs: bool = True,
        alone: bool = False,
    ) -> None:
        self.items: list[AnyItem] = list(items)
        self._suffix, self._at, self._logs = verdict, 0, logs
        args = (tuple(items), folder, core)
        for item in items:
            (folder / f"{item.name}.{verdict}").unlink(missing_ok=True)
        first, limit_s = items[0].name, items[0].limit_s
        super().__init__(
            context, target, args, folder, first, limit_s=limit_s, verdict=verdict, logs=logs
        )
        self.alone = alone

    def _advance_to_current(self) -> None:
        """Move on to the first run or file that the process has not finished yet."""
        while self._at < len(self.items) and self._verdict.exists():
            self._at += 1
            self._born, self._peak_bytes = time.monotonic(), 0.0
            if self._at < len(self.items):
                self.name = self.items[self._at].name
                self._limit_s = self.items[self._at].limit_s
                self._verdict = self.folder / f"{self.name}.{self._suffix}"
                self._running_since = None if self._logs else self._born

    def kill_if_overdue(self) -> bool:
        """Kill the process when its current run or file took too long; return whether it did."""
        self._advance_to_current()
        if self._at < len(self.items):
            return super().kill_if_overdue()
        # Behind its last verdict it has nothing to do but to end.
        return time.monotonic() - self._born > GRACE_S and self.kill("")

    def split_items(self) -> tuple[dict[str, Outcome], list[AnyItem]]:
        """Return the outcomes of an ended process's runs or files, and those still to do."""
        self.join()
        self._advance_to_current()
        outcomes = {}
        for item in self.items[: self._at]:
            outcomes[item.name] = self.read_verdict(self.folder / f"{item.name}.{self._suffix}")
        # A library may bring its process down when it is let go, between two cells.
        not_begun = self._at > 0 and self.notice.page.cell_index < self._at
        if not_begun or self.is_suspect or self._at == len(self.items):
            return outcomes, self.items[self._at :]
        outcomes[self.name] = self.determine_outcome()
        return outcomes, self.items[self._at + 1 :]


class CellRun:
    """Execution of a batch of runs on one core: one process does them, then another judges them.

    to_run : whether the cells are to be run; otherwise they left steps before.
    outcomes : outcome of each cell, without those that a dead fork server took along.
    parts : the cells that left steps, with these.
    """

    def __init__(
        self,
        context: ForkServerContext,
        batch: CellBatch,
        folder: Path,
        cells: Sequence[BatchCell],
        *,
        to_run: bool = True,
    ) -> None:
        self.batch, self.folder = batch, folder
        self._context, self._cells, self._to_run = context, list(cells), to_run
        self.outcomes: dict[str, Outcome] = {}
        self.parts: list[BatchPart] = []

    def start(self, core: int) -> Child:
        """Start the process that does the batch's runs on a core, and return it."""
        return self._start_process_of_cells(self._cells, core)

    def start_next(self, child: Child, core: int) -> Child | None:
        """Store outcomes of a batch's ended process; start and return the next; None at the end."""
        assert isinstance(child, _ItemProcess), "the processes of a batch are its own"
        ended, rest = child.split_items()
        if self._to_run:
            rest = self._resume_hung_cell(ended) + rest
            self.outcomes |= ended
        else:
            rest = self._collect_part(child.items, ended) + rest
        if child.is_suspect:
            for cell in rest:
                self.outcomes.pop(cell.name, None)
                delete_log_and_layout(self.folder / f"{cell.name}.raw")
            rest = []
        if self._to_run and not rest:
            self._to_run = False
            ran = [cell for cell in self._cells if self._has_steps(cell)]
            rest = [replace(cell, outcome=self.outcomes[cell.name]) for cell in ran]
        return self._start_process_of_cells(rest, core) if rest else None

    def _resume_hung_cell(self, ended: dict[str, Outcome]) -> list[BatchCell]:
        """Return the run killed in a hanging step, to be continued after that step; else none."""
        for i, batch_cell in enumerate(self._cells):
            outcome = ended.get(batch_cell.name)
            if outcome is None or outcome.outcome != "hung":
                continue
            raw = self.folder / f"{batch_cell.name}.raw"
            hang = find_hang(Cell.from_json(batch_cell.cell), raw, batch_cell.hung)
            if hang is not None:
                del ended[batch_cell.name]
                self._cells[i] = replace(batch_cell, hung=(*batch_cell.hung, hang))
                return [self._cells[i]]
        return []

    def _collect_part(
        self, cells: Sequence[BatchCell], ended: Mapping[str, Outcome]
    ) -> list[BatchCell]:
        """Store the judged runs' results; return runs to judge again, whose results are gone."""
        lost = {
            name: f"the referee failed on it: {verdict.detail}"
            for name, verdict in ended.items()
            if verdict.outcome != "finished"
        }
        judged = [cell for cell in cells if cell.name in ended and cell.name not in lost]
        path = self.folder / f"{cells[0].name}.judged"
        try:
            self.parts.append(parse_batch_part(path.read_bytes()))
            judged = []
        except DAMAGE as error:
            if len(judged) == len(cells):
                detail = f"its record was removed before it was stored: {error}"
                lost, judged = {cell.name: detail for cell in cells}, []
        self.outcomes |= {name: Outcome("lost", detail) for name, detail in lost.items()}
        return judged

    def _has_steps(self, cell: BatchCell) -> bool:
        """Return whether a run ended with recorded steps to judge."""
        outcome = self.outcomes.get(cell.name)
        # After a fault of the plant the recorded steps are no whole run of the solver.
        if outcome is None or outcome.outcome in ("lost", "invalid"):
            return False
        return (self.folder / f"{cell.name}.raw").exists()

    def _start_process_of_cells(self, cells: Sequence[BatchCell], core: int) -> Child:
        """Start and return a process on one core that runs cells, or judges those already run."""
        target, verdict = run_batch, "json"
        if not self._to_run:
            target, verdict = evaluate_batch, "evaluated.json"
            cells = [replace(cell, limit_s=EVALUATION_LIMIT_S) for cell in cells]
        alone = self.batch.isolated
        return _ItemProcess(
            self._context, target, cells, self.folder, core, verdict=verdict, alone=alone
        )


@dataclass(frozen=True)
class FileTask:
    """A file to make at `path` from a description, within `limit_s` [s] (None: no limit)."""

    description: str
    path: Path
    limit_s: float | None = None

    @property
    def name(self) -> str:
        """Name of the file with the outcome of making this file, without suffix."""
        return self.path.stem


def make_files_in_turn(target: Target, tasks: Sequence[FileTask], folder: Path, core: int) -> None:
    """Make several files from their descriptions, one after the other in this process."""
    for i, task in enumerate(tasks):
        set_phase(Phase.HARNESS, i)
        target(task.description, folder, task.name, core, task.path)


class FileRun:
    """Making of a batch of files on one core, in turn, by one or more processes."""

    def __init__(self, context: ForkServerContext, batch: FileBatch, folder: Path) -> None:
        self.batch, self.folder = batch, folder
        self._context, self.results = context, list[Result]()
        self._paths = {path.stem: str(path) for path in batch.texts}

    def start(self, core: int) -> Child:
        """Start the process that makes the batch's files on a core, and return it."""
        texts, limit_s = self.batch.texts, self.batch.limit_s
        return self._start_process_of_files(
            [FileTask(text, path, limit_s) for path, text in texts.items()], core
        )

    def describe_step(self, child: Child) -> str:
        """Return the step of a reference loop that a process is at; "" if it is quick."""
        done, steps = child.notice.page.step, child.notice.page.steps
        if not steps:
            return ""
        assert isinstance(child, _ItemProcess), "the processes of a batch are its own"
        cell = Cell.from_json(child.items[child.notice.page.cell_index].description)
        return f"step {done} of {steps}, exact loop of {cell.scenario_name}"

    def start_next(self, child: Child, core: int) -> Child | None:
        """Store outcomes of an ended process that made files; start and return the next, if any."""
        assert isinstance(child, _ItemProcess), "the processes of a batch are its own"
        ended, rest = child.split_items()
        self.results += [Result(self._paths[name], outcome) for name, outcome in ended.items()]
        for name in ended:
            (self.folder / f"{name}.json").unlink(missing_ok=True)
        return self._start_process_of_files(rest, core) if rest and not child.is_suspect else None

    def _start_process_of_files(self, tasks: Sequence[FileTask], core: int) -> Child:
        """Start and return a process on one core that makes files."""
        target, alone = partial(make_files_in_turn, self.batch.target), self.batch.isolated
        return _ItemProcess(
            self._context, target, tasks, self.folder, core, logs=False, alone=alone
        )
