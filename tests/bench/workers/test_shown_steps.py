"""Steps of reference loops in the progress of a campaign."""

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from dpbench import load_scenario
from dpbench.bench.progress import Silent
from dpbench.bench.record.cell import Cell
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.workers import shared_status, worker
from dpbench.bench.workers.batch import FileRun, FileTask, _ItemProcess
from dpbench.bench.workers.executor import CellExecutor
from dpbench.bench.workers.jobs import FileBatch
from dpbench.bench.workers.shared_status import Phase, SharedStatus

LOOP = Cell("closed_loop", {"name": "turn"}, "daqp", "native", "fresh", "default", 450)


@pytest.fixture
def status() -> Iterator[SharedStatus]:
    """The status of this process, as if it were a worker."""
    own = SharedStatus()
    shared_status._process_status[:] = [own]
    yield own
    shared_status._process_status.clear()
    own.close_descriptor()


def shown(status: SharedStatus) -> tuple[int, int]:
    """Return the steps done and to do that a process has reported."""
    return status.page.step, status.page.steps


def test_an_exact_loop_reports_each_step() -> None:
    reported: list[tuple[int, int]] = []
    solve_loop_exactly(load_scenario("paper").truncate(3), lambda *step: reported.append(step))
    assert reported == [(1, 3), (2, 3), (3, 3)]


def test_a_worker_reports_the_steps_of_a_long_loop_alone(
    status: SharedStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker._make_step_report()(7, 450)
    assert shown(status) == (0, 0)
    monkeypatch.setattr(worker, "QUICK_S", 0.0)
    report = worker._make_step_report()
    report(8, 450)
    assert shown(status) == (8, 450)
    # The reason of an end is behind it, and the phase before it.
    status.record_exit(Phase.SOLVER, "out of memory")
    assert (shown(status), status.exit_reason) == ((8, 450), "out of memory")
    assert status.phase is Phase.SOLVER
    worker._make_step_report()
    assert shown(status) == (0, 0)


class Shown(Silent):
    """A progress that keeps what it is told of the work in hand."""

    def __init__(self) -> None:
        self.lines: list[tuple[int, str]] = []
        self.advance = lambda work, what: self.lines.append((work, what))


def test_the_step_is_shown_once_a_second(status: SharedStatus, monkeypatch: Any) -> None:
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    batch = FileBatch(worker.make_source, {Path("exact-1.npz"): "{}"})
    run = FileRun(cast(Any, None), batch, Path())
    child = object.__new__(_ItemProcess)
    child.items = [FileTask("{}", Path()), FileTask(LOOP.to_json(), Path())]
    child.notice = status
    shown = Shown()
    executor: Any = SimpleNamespace(progress=shown, _shown_s=0.0)
    CellExecutor._show_step(executor, run, child)
    assert not shown.lines
    status.set_phase(Phase.HARNESS, 1)
    for k, at_s in ((120, 200.0), (121, 200.5), (122, 201.5)):
        now_s[0] = at_s
        status.page.step, status.page.steps = k, 450
        CellExecutor._show_step(executor, run, child)
    what = "step {} of 450, exact loop of turn"
    assert shown.lines == [(0, what.format(120)), (0, what.format(122))]
