"""The dispatcher, with an engine that runs nothing and notes what it is given."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from dpbench.bench.campaign import make_jobs
from dpbench.bench.engines.dispatcher import Dispatcher
from dpbench.bench.engines.engine import Completed, SourceFiles
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.progress import Silent
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.workers.jobs import Batch, FileBatch, Result

LOOP = Cell("closed_loop", {"name": "turn"}, "daqp", "native", "fresh", "default", 20)
REPLAY = replace(LOOP, mode="replay", rounds=1, first=100)


class NotingEngine(ExitStack):
    """An engine whose batches end at once; `needed` are the steps of each file it makes."""

    machine: Any = {"id": "here"}
    slots, remarks = 1, ()

    def __init__(self) -> None:
        super().__init__()
        self.needed: list[int] = []
        self._submitted: list[Batch] = []

    def prepare(self, *_: object) -> None:
        """Nothing is started."""

    def count_batches_to_submit(self, *, timed: bool) -> int:
        return 1

    def submit(self, batch: Batch) -> None:
        if isinstance(batch, FileBatch):
            self.needed += [Cell.from_json(t).steps_needed_in_file for t in batch.texts.values()]
        self._submitted.append(batch)

    def yield_completed_batches(self) -> Iterator[Completed]:
        while self._submitted:
            batch = self._submitted.pop()
            yield batch, [Result(name, Outcome("finished", "")) for name in batch.names]

    def is_qp_file_intact(self, key: str, cell: Cell) -> bool:
        return True

    def release_source(self, key: str) -> None:
        """Nothing is stored."""


def _made_steps(cells: Sequence[Cell], folder: Path) -> list[int]:
    jobs = make_jobs([PlannedCell(cell) for cell in cells], "here")
    engine = NotingEngine()
    results = Dispatcher(engine, SourceFiles(folder), Silent()).yield_results_of_jobs(jobs)
    assert {result.run_id for result in results} == {job.run_id for job in jobs}
    return engine.needed


def test_a_loop_is_made_once_and_as_long_as_later_replays_need(tmp_path: Path) -> None:
    assert _made_steps([LOOP, REPLAY], tmp_path) == [120]
    assert _made_steps([replace(LOOP, steps=300), REPLAY], tmp_path) == [300]
