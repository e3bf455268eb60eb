"""Replay one sequence through many solvers, interleaved round by round.

All workers stay alive; exactly one runs while the others block on their pipes, so machine drift
hits all configurations alike. Within a round the order of configurations is drawn anew from the
seed.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.judge.rules import is_disturbed
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.workers.child import GRACE_S, START_ALLOWANCE_S, Child
from dpbench.bench.workers.robbed import repeat_robbed
from dpbench.bench.workers.worker import run_replay_cell

STARTED_TOGETHER = 4
DISTURBED_RETRIES = 1
"""How often a round in which the reference kernel was slowed is run again."""
FEWEST_ROUNDS = 3
"""Rounds, none of them disturbed, that a configuration gets whatever its budget is."""


class _ReplayWorker:
    """One worker and the state of its service."""

    def __init__(self, run_id: str, cell: Cell, child: Child, orders: Connection) -> None:
        self.run_id, self.cell, self.child, self.orders = run_id, cell, child, orders
        self.serving = True
        self.spent_s = 0.0
        self.clean_rounds = 0

    @property
    def sated(self) -> bool:
        """Whether it has used up its budget and has rounds enough."""
        budget_s = self.cell.budget_s
        return 0.0 < budget_s <= self.spent_s and self.clean_rounds >= FEWEST_ROUNDS

    def wait(self, limit_s: float, late: str = "") -> object:
        """The worker's next word; None when it died, hung (killed as `late` says) or refused."""
        try:
            if self.orders.poll(limit_s):
                return self.orders.recv()
        except (EOFError, OSError):
            return None
        beyond = f"one call ran beyond the limit of {self.cell.limit_s:g} s"
        self.child.kill(f"{late or beyond} and was killed")
        return None

    def order(self, r: int) -> None:
        """Ask for round r; of a worker that died meanwhile `wait` knows."""
        with suppress(OSError):
            self.orders.send(r)


class ReplayGroup:
    """The configurations that replay one sequence.

    Parameters
    ----------
    cells : (run_id, cell) of each configuration; all see the same QPs.
    source : the file the sequence is made from.
    core : where the one running worker is pinned.
    """

    def __init__(
        self,
        context: ForkServerContext,
        folder: Path,
        source: Path,
        core: int,
        cells: list[tuple[str, Cell]],
    ) -> None:
        self._context, self._folder, self._source, self._core = context, folder, source, core
        self._cells = cells
        self.outcomes: dict[str, Outcome] = {}

    def run(self) -> Iterator[int]:
        """Run all rounds; yields the number of each finished round, 0 for the warm-up."""
        workers: list[_ReplayWorker] = []
        try:
            # Importing a library takes a second, so a few workers start side by side.
            late = f"did not start within {START_ALLOWANCE_S:g} s"
            for i in range(0, len(self._cells), STARTED_TOGETHER):
                batch = [self._start(*entry) for entry in self._cells[i : i + STARTED_TOGETHER]]
                workers += batch
                for worker in batch:
                    worker.serving = worker.wait(START_ALLOWANCE_S, late) is True
            rounds = max(cell.rounds for _, cell in self._cells)
            order = random.Random(self._cells[0][1].seed)
            for r in range(rounds + 1):
                for worker in order.sample(workers, len(workers)):
                    if worker.serving and r <= worker.cell.rounds and not worker.sated:
                        self._serve(worker, r)
                yield r
            self._repeat_robbed(workers, order)
        finally:
            for worker in workers:
                self._close(worker)

    def _repeat_robbed(self, workers: list[_ReplayWorker], order: random.Random) -> None:
        """Run robbed rounds again; of workers whose log somebody removed there are none to tell."""
        logs: dict[str, RawLog] = {}
        for worker in workers:
            if worker.serving:
                with suppress(OSError, ValueError):
                    logs[worker.run_id] = self._log(worker)
        repeat_robbed(
            [worker for worker in workers if worker.run_id in logs], logs, self._serve, order
        )

    def _start(self, run_id: str, cell: Cell) -> _ReplayWorker:
        ours, theirs = self._context.Pipe()
        args = (cell.to_json(), self._folder, run_id, self._core, self._source, theirs)
        child = Child(
            self._context, run_replay_cell, args, self._folder, run_id, limit_s=cell.limit_s
        )
        theirs.close()
        return _ReplayWorker(run_id, cell, child, ours)

    def _serve(self, worker: _ReplayWorker, r: int) -> None:
        for _ in range(DISTURBED_RETRIES + 1):
            worker.order(r)
            started = time.monotonic()
            done = worker.wait(worker.cell.limit_s + GRACE_S)
            worker.spent_s += time.monotonic() - started
            if done is not True:
                worker.serving = False
                return
            if r == 0:
                return
            if not self._disturbed(worker, r):
                worker.clean_rounds += 1
                return

    def _disturbed(self, worker: _ReplayWorker, r: int) -> bool:
        """Whether the reference kernel around round r was slow against the worker's other
        rounds."""
        try:
            kernel_ns = self._log(worker).reference_kernel_ns
        except (OSError, ValueError):
            # Somebody removed the log; it is lost when it is to be judged.
            return False
        return bool(is_disturbed(kernel_ns)[r])

    def _log(self, worker: _ReplayWorker) -> RawLog:
        """What the worker has recorded so far."""
        return RawLog.open(self._folder / f"{worker.run_id}.raw")

    def _close(self, worker: _ReplayWorker) -> None:
        with suppress(OSError):
            worker.orders.send(None)
        worker.child.process.join(GRACE_S)
        if worker.child.process.is_alive():
            # Behind its verdict a worker only counts allocations, which is no reason to blame it.
            worker.child.kill("" if worker.child.has_verdict else "did not end when asked to")
        worker.orders.close()
        self.outcomes[worker.run_id] = worker.child.outcome()
