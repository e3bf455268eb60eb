"""The searched solver in a process of its own, which answers one sequence after the other.

A solver that crashes or hangs costs the sequence it failed on; the next one gets a new process.
Every sequence is answered by a new workspace in the way `inprocess.replay` and a campaign do it (a
warm-up round, then one that counts), so that what is found replays to the same figures.
"""

from __future__ import annotations

import gc
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.judge.closed_loop import Evaluated
from dpbench.bench.judge.replay import evaluate_sequence
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import RawLog, replay_layout
from dpbench.bench.run.formulation import in_replay
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.bench.workers.child import GRACE_S, START_ALLOWANCE_S, Child
from dpbench.bench.workers.notice import AtWork, post
from dpbench.bench.workers.process_setup import settle
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence
from dpbench.solvers.contract import Workspace
from dpbench.solvers.isolation import isolate
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import load_solver_module

ROUNDS = 2
"""The warm-up and one that counts."""
_NAME = "searched"


class SearchedSolver:
    """One configuration, ready to answer sequences.

    Parameters
    ----------
    context : what forks its processes; folder : where they leave raw logs and noise.
    cell : the configuration: solver, route, policy, settings, formulation, warm-up, plug-in; what
        else a cell says is not looked at.

    Raises
    ------
    InputError : the configuration cannot run, for the reason it gives.
    """

    def __init__(self, context: ForkServerContext, folder: Path, cell: Cell) -> None:
        self._context, self._folder, self._cell = context, folder, cell
        self._start()

    def _start(self) -> None:
        self._orders, theirs = self._context.Pipe()
        args = (self._cell.to_json(), self._folder, theirs)
        self._child = Child(self._context, serve, args, self._folder, _NAME, limit_s=None)
        theirs.close()
        found = self._wait(START_ALLOWANCE_S)
        if isinstance(found, InputError):
            raise found
        if found is not True:
            outcome = self._child.outcome()
            where, detail = f"solver {self._cell.solver}", f"{outcome.outcome}: {outcome.detail}"
            raise InputError(where, "", detail, "a solver that starts in a process of its own")

    def answer(self, sequence: QPSequence, limit_s: float) -> tuple[Outcome, Evaluated | None]:
        """Replay a sequence in at most `limit_s` of run time, and judge the answers.

        Returns
        -------
        What became of the process (`finished`, `timed_out`, `hung`, `crashed` or `lost`), and the
        judged columns of the steps it came to, None where there are none.
        """
        raw = self._folder / f"{_NAME}.raw"
        raw.unlink(missing_ok=True)
        # A process that died after its last answer is found dead by the wait for the next one.
        with suppress(OSError):
            # How to make it in another form is not needed there, and large.
            self._orders.send((replace(sequence, sparse_equivalent=None), limit_s))
        reply = self._wait(limit_s + GRACE_S)
        outcome = Outcome("finished", "")
        if reply is False:
            outcome = Outcome("timed_out", f"the sequence took more than {limit_s:g} s")
        elif reply is not True:
            outcome = self._child.outcome()
            self._orders.close()
            self._start()
        if not raw.exists():
            return outcome, None
        sample_s = float(sequence.meta.get("sample_s", float("nan")))
        return outcome, evaluate_sequence(RawLog.open(raw), sequence, sample_s)

    def _wait(self, limit_s: float) -> object:
        """The next word of the process; None when it died, or hung and was killed."""
        try:
            if self._orders.poll(limit_s):
                return self._orders.recv()
        except (EOFError, OSError):
            return None
        self._child.kill(f"one call ran beyond the limit of {limit_s:g} s and was killed")
        return None

    def close(self) -> None:
        """End the process."""
        with suppress(OSError):
            self._orders.send(None)
        self._child.process.join(GRACE_S)
        if self._child.process.is_alive():
            self._child.kill("did not end when asked to")
        self._orders.close()


def serve(text: str, folder: Path, orders: Connection) -> None:
    """Open the configuration of a cell and answer sequences until None is ordered; a process's
    target."""
    settle(folder / f"{_NAME}.noise")
    cell = Cell.from_json(text)
    post(AtWork.OPENING)
    try:
        if cell.solver_module:
            load_solver_module(cell.solver_module)
        isolate(cell.solver)
        _open(cell)
    except InputError as error:
        orders.send(error)
        return
    orders.send(True)
    while (order := orders.recv()) is not None:
        sequence, limit_s = order
        orders.send(_answer(cell, sequence, limit_s, folder / f"{_NAME}.raw"))
        # The collector is off while a solver works.
        gc.collect()


def _open(cell: Cell) -> Workspace:
    return open_workspace(cell.solver, route=cell.route, policy=cell.policy, settings=cell.settings)


def _answer(cell: Cell, sequence: QPSequence, limit_s: float, raw: Path) -> bool:
    base, steps, clock = sequence.base, len(sequence), time.perf_counter_ns
    post(AtWork.HARNESS)
    log = RawLog.create(raw, replay_layout(ROUNDS, steps, base.n, base.m))
    made, formulated = in_replay(cell.formulation, sequence)
    post(AtWork.SOLVER)
    timed_solver = TimedSolver(_open(cell), formulated, clock)
    configuration = ReplayRun(
        made,
        timed_solver,
        log,
        warmup_steps=min(cell.warmup_steps, steps),
        limit_ns=round(limit_s * 1e9),
        clock=clock,
    )
    return all(configuration.round(r) for r in range(ROUNDS))
