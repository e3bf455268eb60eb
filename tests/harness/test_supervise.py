"""A cell's process that crashes, hangs or never starts becomes an outcome."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.context import ForkServerContext
from pathlib import Path

import numpy as np
import pytest

from dpbench.bench import supervise
from dpbench.bench.cell_process import verdict_of, write_verdict
from dpbench.bench.rawlog import RawLog, replay_layout
from dpbench.bench.supervise import Child, template_context


@pytest.fixture(scope="module")
def context() -> ForkServerContext:
    return template_context()


def wait(child: Child, seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while child.process.is_alive() and not child.overdue():
        assert time.monotonic() < deadline, "the supervisor did not end the process"
        time.sleep(0.01)


def test_a_crash_is_an_outcome_with_its_signal(context: ForkServerContext, tmp_path: Path) -> None:
    """A process that a signal kills is `crashed`, and the detail names the signal."""
    child = Child(context, signal.raise_signal, (signal.SIGSEGV,), tmp_path, "cell", limit_s=5.0)
    child.process.join()
    outcome = child.outcome()
    assert (outcome.outcome, outcome.detail) == ("crashed", "killed by SIGSEGV")


def test_an_exit_without_a_verdict_is_a_crash(context: ForkServerContext, tmp_path: Path) -> None:
    """A process that ends on its own without a verdict is `crashed` with its exit code."""
    child = Child(context, os._exit, (3,), tmp_path, "cell", limit_s=5.0)
    wait(child)
    assert child.outcome().outcome == "crashed"
    assert "exit code 3" in child.outcome().detail


def test_a_hanging_call_is_killed_and_its_steps_stay(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One call that does not return is killed after the limit; the log keeps what was done."""
    monkeypatch.setattr(supervise, "GRACE_S", 0.1)
    log = RawLog.create(tmp_path / "cell.raw", replay_layout(1, 4, 2, 2))
    log.z[0, 0] = [1.0, 2.0]
    log.done[0] = 1
    log.started[0] = 1
    child = Child(context, time.sleep, (600.0,), tmp_path, "cell", limit_s=0.2)
    wait(child)
    assert child.outcome().outcome == "timed_out"
    assert "limit of 0.2 s" in child.outcome().detail
    np.testing.assert_array_equal(RawLog.open(tmp_path / "cell.raw").z[0, 0], [1.0, 2.0])


def test_a_process_that_never_starts_its_loop_is_killed(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An import that hangs is ended by the allowance for starting."""
    monkeypatch.setattr(supervise, "START_ALLOWANCE_S", 0.2)
    child = Child(context, time.sleep, (600.0,), tmp_path, "cell", limit_s=5.0)
    wait(child)
    assert child.outcome().outcome == "timed_out"
    assert "did not start" in child.outcome().detail


def test_a_process_killed_behind_its_verdict_keeps_it(
    context: ForkServerContext, tmp_path: Path
) -> None:
    """What a worker does after it said what became of the cell is no part of the cell."""
    child = Child(context, time.sleep, (600.0,), tmp_path, "cell", limit_s=5.0)
    assert not child.has_verdict
    write_verdict(tmp_path / "cell.json", verdict_of("finished", ""))
    child.kill("" if child.has_verdict else "no verdict")
    assert child.outcome().outcome == "finished"


def test_the_template_pins_threads_and_leaves_the_caller_alone(
    context: ForkServerContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Making the template does not change the environment of the process that asks for it."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    template_context()
    assert os.environ["OMP_NUM_THREADS"] == "7"
