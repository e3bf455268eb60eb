"""Replay one sequence through many solvers, interleaved round by round.

All workers stay alive; exactly one runs while the others block on their pipes, so machine drift
hits all arms alike. Within a round the order of arms is drawn anew from the seed.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.judge.rules import is_spoilt
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.workers.child import GRACE_S, START_ALLOWANCE_S, Child
from dpbench.bench.workers.robbed import repeat_robbed
from dpbench.bench.workers.worker import run_replay_cell

STARTED_TOGETHER = 4
SPOILT_RETRIES = 1
"""How often a round in which the reference kernel was slowed is run again."""
FEWEST_ROUNDS = 3
"""Rounds, none of them spoilt, that an arm gets whatever its budget is."""


class _Arm:
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
    """The arms that replay one sequence.

    Parameters
    ----------
    cells : (run_id, cell) of each arm; all see the same QPs.
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
        arms: list[_Arm] = []
        try:
            # Importing a library takes a second, so a few workers start side by side.
            late = f"did not start within {START_ALLOWANCE_S:g} s"
            for i in range(0, len(self._cells), STARTED_TOGETHER):
                batch = [self._start(*entry) for entry in self._cells[i : i + STARTED_TOGETHER]]
                arms += batch
                for arm in batch:
                    arm.serving = arm.wait(START_ALLOWANCE_S, late) is True
            rounds = max(cell.rounds for _, cell in self._cells)
            order = random.Random(self._cells[0][1].seed)
            for r in range(rounds + 1):
                for arm in order.sample(arms, len(arms)):
                    if arm.serving and r <= arm.cell.rounds and not arm.sated:
                        self._serve(arm, r)
                yield r
            self._repeat_robbed(arms, order)
        finally:
            for arm in arms:
                self._close(arm)

    def _repeat_robbed(self, arms: list[_Arm], order: random.Random) -> None:
        """Run robbed rounds again; of arms whose log somebody removed there are none to tell."""
        logs: dict[str, RawLog] = {}
        for arm in arms:
            if arm.serving:
                with suppress(OSError, ValueError):
                    logs[arm.run_id] = self._log(arm)
        repeat_robbed([arm for arm in arms if arm.run_id in logs], logs, self._serve, order)

    def _start(self, run_id: str, cell: Cell) -> _Arm:
        ours, theirs = self._context.Pipe()
        args = (cell.to_json(), self._folder, run_id, self._core, self._source, theirs)
        child = Child(
            self._context, run_replay_cell, args, self._folder, run_id, limit_s=cell.limit_s
        )
        theirs.close()
        return _Arm(run_id, cell, child, ours)

    def _serve(self, arm: _Arm, r: int) -> None:
        for _ in range(SPOILT_RETRIES + 1):
            arm.order(r)
            started = time.monotonic()
            done = arm.wait(arm.cell.limit_s + GRACE_S)
            arm.spent_s += time.monotonic() - started
            if done is not True:
                arm.serving = False
                return
            if r == 0:
                return
            if not self._spoilt(arm, r):
                arm.clean_rounds += 1
                return

    def _spoilt(self, arm: _Arm, r: int) -> bool:
        """Whether the reference kernel around round r was slow against the arm's other rounds."""
        try:
            probes = self._log(arm).probe_ns
        except (OSError, ValueError):
            # Somebody removed the log; it is lost when it is to be judged.
            return False
        return bool(is_spoilt(probes)[r])

    def _log(self, arm: _Arm) -> RawLog:
        """What the arm has recorded so far."""
        return RawLog.open(self._folder / f"{arm.run_id}.raw")

    def _close(self, arm: _Arm) -> None:
        with suppress(OSError):
            arm.orders.send(None)
        arm.child.process.join(GRACE_S)
        if arm.child.process.is_alive():
            # Behind its verdict a worker only counts allocations, which is no reason to blame it.
            arm.child.kill("" if arm.child.has_verdict else "did not end when asked to")
        arm.orders.close()
        self.outcomes[arm.run_id] = arm.child.outcome()
