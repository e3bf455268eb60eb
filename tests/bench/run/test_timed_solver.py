"""A step that hangs is ended, and a loop goes on behind one that was killed as if it had failed."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench import load_scenario, open_workspace
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import Layout, RawLog, make_loop_layout
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.backup import WARM_UP_SOLVES
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.bench.run.formulation import BoxFormulation
from dpbench.bench.run.slow_computer import return_zero_usage
from dpbench.bench.run.timed_solver import HANG_DETAIL, RunDelay, TimedSolver, raise_at_step_limit
from dpbench.bench.workers.worker import find_hang
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.contract import Workspace, describe_exception_unless_interrupt

LIMIT_S = 0.05


class Spinning(Workspace):
    """Does not return from its first solve."""

    def __init__(self, *, catches: bool) -> None:
        super().__init__("spinning", "native", "reuse")
        self.setups, self._solves, self._catches, self._words = 0, 0, catches, ""

    def setup(self, qp: QuadraticProgram) -> None:
        self.setups += 1

    def update(self, step: QPStep) -> None:
        pass

    def solve(self) -> None:
        self._solves += 1
        try:
            while self._solves == 1:
                pass
        except BaseException as error:
            if not self._catches:
                raise
            self._words = describe_exception_unless_interrupt(error)

    def read(self) -> Solution:
        return Solution(Status.SOLVED, np.ones(1), np.zeros(1), np.zeros(1))


def timed(workspace: Workspace) -> TimedSolver:
    one = np.ones(1)
    problem = QuadraticProgram(np.eye(1), one, np.eye(1), -one, one, -one, one)
    return TimedSolver(workspace, BoxFormulation(problem), time.perf_counter_ns)


STEP = QPStep(np.ones(1), -np.ones(1), np.ones(1))


@pytest.mark.parametrize("catches", [True, False])
def test_what_runs_python_is_interrupted_and_set_up_anew(catches: bool) -> None:
    workspace = Spinning(catches=catches)
    solver = timed(workspace)
    solver.prepare()
    with raise_at_step_limit(LIMIT_S, time.perf_counter_ns):
        answer = solver.answer(STEP)
        assert answer.status is Status.TIME_LIMIT and "limit of 0.05 s" in answer.detail
        assert sum(ns for ns in solver.phases_ns if ns > 0) >= LIMIT_S * 1e9
        solver.reset()
        assert workspace.setups == 2
        assert solver.answer(STEP).status is Status.SOLVED


@pytest.mark.parametrize("every_step", [False, True])
def test_only_waits_within_a_step_are_booked_on_it(
    every_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step has the 70 ns of waits within it and none of the 50 ms before it."""
    total_ns = [1000]

    class Waiting(Spinning):
        def solve(self) -> None:
            total_ns[0] += 70

    monkeypatch.setattr(RunDelay, "read_total_ns", lambda self: total_ns[0])
    workspace = Waiting(catches=False)
    workspace.setup_every_step = every_step
    solver = timed(workspace)
    solver.prepare()
    for _ in range(3):
        total_ns[0] += 50_000_000
        solver.answer(STEP)
        assert solver.waited_ns == 70


def test_an_alarm_outside_of_a_step_is_none() -> None:
    solver = timed(Spinning(catches=False))
    with raise_at_step_limit(0.01, time.perf_counter_ns):
        until = time.monotonic() + 0.05
        while time.monotonic() < until:
            pass
    assert not solver.interrupted


class Leaving(Workspace):
    """Drives another workspace, and exits or fails in one step."""

    def __init__(self, inner: Workspace, at: int, *, fails: bool, k: int = -1) -> None:
        super().__init__(inner.solver, inner.route, inner.policy)
        self._inner, self._at, self._fails, self._k = inner, at, fails, k
        self.setup_every_step = inner.setup_every_step
        self.setup, self.reset = inner.setup, inner.reset  # type: ignore[method-assign]  # as they are

    def update(self, step: QPStep) -> None:
        self._k += 1
        self._inner.update(step)

    def solve(self) -> None:
        if self._k == self._at and not self._fails:
            raise SystemExit
        self._inner.solve()

    def read(self) -> Solution:
        answer = self._inner.read()
        if self._k == self._at and self._fails:
            return Solution.without_point(
                len(answer.z), len(answer.y), Status.TIME_LIMIT, HANG_DETAIL
            )
        return answer

    def setup(self, qp: QuadraticProgram) -> None:
        raise AssertionError("replaced")


SAMPLE_S = 0.3


class _Late(Leaving):
    """Leaves as `Leaving`; takes more than a sample in step 4, which a slow computer notices."""

    def solve(self) -> None:
        if self._k == 4 or (self._k == self._at and self._fails):
            time.sleep(1.1 * SAMPLE_S)
        super().solve()


def goes_on(
    name: str,
    leaving: Callable[[Workspace, bool], Workspace],
    at: int,
    limit_ns: int,
    **fields: Any,
) -> tuple[RawLog, RawLog]:
    """Return the log of a loop that goes on after it hung, and of one that failed in that step."""
    steps = at + 9
    scenario = load_scenario(name).truncate(steps)
    cell = Cell(
        "closed_loop", scenario.files, "daqp", "native", "reuse", "default", steps, **fields
    )
    logs: list[RawLog] = []

    def new_log(layout: Layout) -> RawLog:
        logs.append(RawLog.in_memory(layout))
        return logs[-1]

    def opened() -> Workspace:
        return open_workspace("daqp", route="native", policy="reuse")

    for fails in (True, False):
        workspace = leaving(opened(), fails)
        workspace.reopen = opened
        setup = build_closed_loop_setup(cell, scenario, workspace, new_log, NO_LIMIT_NS)
        setup.usage = return_zero_usage
        with nullcontext() if fails else pytest.raises(SystemExit):
            assert record_closed_loop(setup)
    expected, log = logs
    assert log.done[0] == at
    ready_ns = None if log.backup is None else log.backup.ready_ns[:at].copy()
    again = build_closed_loop_setup(cell, scenario, opened(), lambda _: log, limit_ns, hung=[at])
    again.limit_ns, again.usage = NO_LIMIT_NS, return_zero_usage
    late_ns = log.latency_ns.copy()
    assert record_closed_loop(again)
    for array in ("state", "tau", "status", "flags", "iterations"):
        np.testing.assert_array_equal(getattr(log, array), getattr(expected, array))
    np.testing.assert_array_equal(log.latency_ns[:at], late_ns[:at])
    if log.backup is not None and expected.backup is not None:
        np.testing.assert_array_equal(log.backup.acted, expected.backup.acted)
        np.testing.assert_array_equal(log.backup.ready_ns[:at], ready_ns)
    return log, expected


@pytest.mark.parametrize(
    ("name", "backup"), [("paper", ""), ("waves", "paper_active_set"), ("thrusters_cascade", "")]
)
def test_a_loop_goes_on_behind_the_step_that_hung(name: str, backup: str) -> None:
    def leaving(inner: Workspace, fails: bool) -> Workspace:
        return Leaving(inner, 11, fails=fails)

    log, expected = goes_on(name, leaving, 11, 10**9, backup=backup)
    np.testing.assert_array_equal(log.z, expected.z)
    assert log.times[0, 11, 3] == 10**9 and log.matrix_updates[0] == expected.matrix_updates[0]


@pytest.mark.slow
@pytest.mark.alone  # A step of any other solve that takes a sample would be late too.
@pytest.mark.parametrize("backup", ["", "paper_active_set"])
def test_a_slow_computer_goes_on_behind_the_step_that_hung(backup: str) -> None:
    limit_ns, at = round(1.1 * SAMPLE_S * 1e9), 11
    # Without a backup step 5 is not solved, as the processor is busy; one stops the late step 4.
    solved = at if backup else at - 1

    def leaving(inner: Workspace, fails: bool) -> Workspace:
        return _Late(inner, solved, fails=fails, k=-1 - WARM_UP_SOLVES)

    deadline_s = 0.2 if backup else 0.0
    log, _ = goes_on(
        "paper", leaving, at, limit_ns, slowdown=1.0, backup=backup, deadline_s=deadline_s
    )
    assert log.latency_ns[at] == limit_ns
    assert np.flatnonzero(log.latency_ns < 0).tolist() == ([] if backup else [5, at + 1])
    if log.backup is not None:
        assert np.flatnonzero(log.backup.ready_ns >= 0).tolist() == [4, at]


def test_a_killed_loop_of_a_slow_computer_goes_on(tmp_path: Path) -> None:
    cell = Cell(
        *("closed_loop", load_scenario("paper").files, "daqp", "native", "reuse", "default", 9),
        slowdown=2.0,
        backup="quadprog",
    )
    log = RawLog.create(tmp_path / "a.raw", make_loop_layout(9, 3, 3, 3))
    log.started[0], log.done[0] = 1, 4
    assert find_hang(cell, tmp_path / "a.raw", []) == (0, 4)
