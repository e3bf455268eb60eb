"""Replay one sequence through many solvers, interleaved round by round.

All workers stay alive; exactly one runs while the others block on their pipes, so machine drift
hits all configurations alike. A finished worker waits for the next sequence of its configuration.
Within a round the order of configurations is drawn from the seed. Rounds that other load slowed
run again at the end, within a budget.

A neighbour may slow every step of a round by up to a factor of two, for milliseconds or minutes,
which the counters do not show: over 14 runs of 14 configurations on a shared machine the slowdown
of a round correlated with the load kernel around it at 0.8, with steal time at 0.2 and with
involuntary switches at 0.3. What those two take hits few steps of a round, and the minimum over the
rounds passes over them.

The load kernel selects the rounds to repeat, never the solver's own times: that would make a ratio
of two runs smaller than it is.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from multiprocessing.context import ForkServerContext
from pathlib import Path
from random import Random

import numpy as np
from numpy.typing import NDArray

from dpbench.bench.judge.rules import mask_disturbed_rounds
from dpbench.bench.record.cell import CONFIGURATION_COLUMNS, Cell, Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.workers.child import ServingChild
from dpbench.bench.workers.worker import Hang, ReplayOrder, find_hang, serve_replays

STARTED_TOGETHER = 4
DISTURBED_RETRIES = 1  # How often a round in which the reference kernel was slowed is run again
FEWEST_ROUNDS = 3
"""Rounds, none of them disturbed, that a configuration gets whatever its budget is."""
FEWEST_OF_WINDOW = 2  # The same for a window, whose steps are the longest of all
ROBBED_FACTOR = 1.25
"""A round whose load kernel took this much longer than in the quietest round of any
configuration."""


class ReplayWorker:
    """One solver configuration's worker process in an interleaved replay, and its progress.

    serving : whether it takes further rounds.
    spent_s : time of its rounds; clean_rounds : undisturbed ones.
    hung : steps in which earlier processes of it hung.
    """

    def __init__(self, run_id: str, cell: Cell, child: ServingChild) -> None:
        self.run_id, self.cell, self.child = run_id, cell, child
        self.serving = True
        self.spent_s = 0.0
        self.clean_rounds = 0
        self.hung: tuple[Hang, ...] = ()

    @property
    def is_budget_exhausted(self) -> bool:
        """Return whether the replay's time budget is used up after enough undisturbed rounds."""
        budget_s = self.cell.budget_s
        fewest = FEWEST_OF_WINDOW if self.cell.is_hardest_window else FEWEST_ROUNDS
        return 0.0 < budget_s <= self.spent_s and self.clean_rounds >= fewest


class IdleWorkers:
    """Worker processes on one core that wait for another replay, by solver configuration."""

    def __init__(self, context: ForkServerContext, core: int) -> None:
        self._context, self._core = context, core
        self._idle: dict[tuple[str, ...], ServingChild] = {}

    def start_replay(self, order: ReplayOrder, cell: Cell) -> ServingChild:
        """Begin a replay in a waiting worker process or a new one; return the process."""
        child = self._idle.pop(make_process_key(cell), None)
        # One whose template died counts as dead too.
        if child is not None and not child.process.is_alive():
            child.dismiss()
            child = None
        if child is not None:
            child.begin_cell(order.folder, order.name)
        else:
            target = serve_replays, (self._core,), order.folder, order.name
            child = ServingChild(self._context, *target, limit_s=cell.limit_s)
        child.send_order(order)
        return child

    def finish_replay(self, child: ServingChild, cell: Cell) -> Outcome:
        """End a replay and return its outcome; its process waits for another if it lives."""
        outcome, key = child.finish_cell(), make_process_key(cell)
        if child.process.is_alive() and key not in self._idle:
            self._idle[key] = child
        else:
            child.dismiss()
        return outcome

    def close(self) -> None:
        """End all worker processes that wait for another replay."""
        idle, self._idle = [*self._idle.values()], {}
        for child in idle:
            child.send_order(None)
        for child in idle:
            child.dismiss()


def make_process_key(cell: Cell) -> tuple[str, ...]:
    """Return a key that is equal for replays that one worker process may do in turn."""
    return (cell.solver_module, *(str(getattr(cell, name)) for name in CONFIGURATION_COLUMNS))


class ReplayGroup:
    """Replay of one sequence of QPs by several solver configurations in interleaved rounds.

    cells : (run_id, cell) of each configuration; all see the same QPs.
    source : file the sequence is made from.
    alone : whether nothing else runs because a template died, see `Child`.
    """

    def __init__(
        self,
        processes: IdleWorkers,
        folder: Path,
        source: Path,
        cells: list[tuple[str, Cell]],
        *,
        alone: bool = False,
    ) -> None:
        self._processes, self._folder, self._source = processes, folder, source
        self._cells, self._alone = cells, alone
        self.outcomes: dict[str, Outcome] = {}

    def run_rounds(self) -> Iterator[int]:
        """Replay all rounds with all solvers; yield each finished round, 0 for the warm-up."""
        workers: list[ReplayWorker] = []
        try:
            # Importing a library takes a second, so a few workers start side by side.
            for i in range(0, len(self._cells), STARTED_TOGETHER):
                for run_id, cell in self._cells[i : i + STARTED_TOGETHER]:
                    workers.append(ReplayWorker(run_id, cell, self._start_child(run_id, cell)))
                for worker in workers[i:]:
                    worker.serving = worker.child.wait_until_ready() is True
            rounds = max(cell.rounds for _, cell in self._cells)
            order = Random(self._cells[0][1].seed)
            for r in range(rounds + 1):
                for worker in order.sample(workers, len(workers)):
                    due = r <= worker.cell.rounds and not worker.is_budget_exhausted
                    if worker.serving and due:
                        self.run_round(worker, r)
                yield r
            self._rerun_loaded_rounds(workers, order)
        finally:
            for worker in workers:
                outcome = self._processes.finish_replay(worker.child, worker.cell)
                self.outcomes[worker.run_id] = outcome

    def _rerun_loaded_rounds(self, workers: list[ReplayWorker], order: Random) -> None:
        """Repeat the rounds that other load disturbed, in the workers that are still serving."""
        logs: dict[str, RawLog] = {}
        for worker in workers:
            if worker.serving:
                with suppress(OSError, ValueError):
                    logs[worker.run_id] = self._open_log(worker)
        serving = [worker for worker in workers if worker.run_id in logs]
        rerun_loaded_rounds(serving, logs, self.run_round, order)

    def _start_child(self, run_id: str, cell: Cell, hung: tuple[Hang, ...] = ()) -> ServingChild:
        """Start one solver's replay in a waiting or new worker process; return the process."""
        order = ReplayOrder(cell.to_json(), self._source, self._folder, run_id, hung)
        child = self._processes.start_replay(order, cell)
        child.alone = self._alone
        return child

    def run_round(self, worker: ReplayWorker, r: int) -> None:
        """Replay one round with one solver configuration, once more where it was disturbed."""
        for _ in range(DISTURBED_RETRIES + 1):
            worker.child.send_order(r)
            started = time.monotonic()
            done = worker.child.wait_for_reply(worker.cell.limit_s)
            worker.spent_s += time.monotonic() - started
            if done is not True:
                # One whose time limit stopped the round still waits for orders.
                worker.serving = done is None and self._resume_hung_worker(worker)
                if worker.serving:
                    self.run_round(worker, r)
                return
            if r == 0:
                return
            if not self._is_disturbed(worker, r):
                worker.clean_rounds += 1
                return

    def _resume_hung_worker(self, worker: ReplayWorker) -> bool:
        """Continue a replay killed in a hanging step in a new process; return whether it runs."""
        if worker.child.determine_outcome().outcome != "hung":
            return False
        hang = find_hang(worker.cell, worker.child.raw_path, worker.hung)
        if hang is None:
            return False
        worker.child.dismiss()
        worker.hung = (*worker.hung, hang)
        worker.child = self._start_child(worker.run_id, worker.cell, worker.hung)
        return worker.child.wait_until_ready() is True

    def _is_disturbed(self, worker: ReplayWorker, r: int) -> bool:
        """Return whether the machine-speed test around replay round r ran too slowly."""
        try:
            return bool(mask_disturbed_rounds(self._open_log(worker).reference_kernel_ns)[r])
        except (OSError, ValueError):
            # Somebody removed the log; it is lost when it is to be judged.
            return False

    def _open_log(self, worker: ReplayWorker) -> RawLog:
        """Open the raw log of a worker's replay."""
        return RawLog.open(self._folder / f"{worker.run_id}.raw")


def measure_load(log: RawLog) -> NDArray[np.float64]:
    """Return the load test's time around each round [ns], on its quieter side, or NaN."""
    levels: NDArray[np.float64] = np.median(log.load_kernel_ns, axis=2).min(axis=1)
    levels[(levels <= 0.0) | (log.done == 0)] = np.nan
    levels[0] = np.nan
    return levels


def find_most_loaded_round(levels: NDArray[np.float64], quietest: float) -> int | None:
    """Return the replay round with the slowest machine-load test; None where none was slowed."""
    robbed = np.flatnonzero(levels > ROBBED_FACTOR * quietest)
    return int(robbed[np.argmax(levels[robbed])]) if len(robbed) else None


def rerun_loaded_rounds(
    configurations: Sequence[ReplayWorker],
    logs: Mapping[str, RawLog],
    serve: Callable[[ReplayWorker, int], None],
    order: Random,
) -> None:
    """Replay rounds again that other load slowed, one per solver in turn, within its budget.

    The last attempt counts. Configurations take turns because a neighbour stays for longer than a
    round.

    logs : raw log of each configuration; serve : runs a round of a configuration into it.
    order : of the configurations within a turn.
    """
    # Within its own limit too: a repetition must not end a configuration that had done its work.
    cells = {one.run_id: (one.spent_s, one.cell) for one in configurations}
    end_s = {k: min(spent_s + c.repeat_budget_s, c.limit_s) for k, (spent_s, c) in cells.items()}
    while True:
        serving = [one for one in configurations if one.serving]
        levels = {one.run_id: measure_load(logs[one.run_id]) for one in serving}
        quietest = float(np.fmin.reduce([np.nan, *map(np.fmin.reduce, levels.values())]))
        due = []
        for one in serving:
            r = find_most_loaded_round(levels[one.run_id], quietest)
            if r is not None:
                took_s = float(np.nan_to_num(logs[one.run_id].counters[r, 0]))
                if one.spent_s + took_s < end_s[one.run_id]:
                    due.append((one, r))
        if not due:
            return
        for one, r in order.sample(due, len(due)):
            serve(one, r)
