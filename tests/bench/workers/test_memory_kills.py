"""Outcomes of processes killed by SIGKILL, with and without want of memory."""

import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from dpbench.bench.record.cell import Outcome
from dpbench.bench.workers import child as supervise
from dpbench.bench.workers.child import Child
from dpbench.bench.workers.shared_status import Phase

VMSTAT = """nr_free_pages 1137
pgfault 5512
oom_kill_disable 9
oom_kill {kills}
drop_pagecache 4
"""
BY_MEMORY = "killed by SIGKILL, probably by the out-of-memory killer"


class Ended:
    """A process that has ended with an exit code."""

    pid = None

    def __init__(self, exitcode: int) -> None:
        self.exitcode = exitcode

    def join(self, timeout: float | None = None) -> None:
        """Return at once."""


@pytest.fixture
def vmstat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "vmstat"
    path.write_text(VMSTAT.format(kills=3), encoding="ascii")

    def opened(name: str) -> Path:
        assert name == "/proc/vmstat"
        return path

    monkeypatch.setattr(supervise, "Path", opened)
    monkeypatch.setattr(supervise, "_start_process", lambda process: None)
    return path


def killed(folder: Path, number: int, who: Phase = Phase.SOLVER) -> Child:
    """Return a child killed by a signal while `who` was at work."""
    context = SimpleNamespace(Process=lambda **_: Ended(-number))
    child = Child(cast(Any, context), print, (), folder, "cell", limit_s=None)
    child.notice.set_phase(who)
    return child


@pytest.mark.parametrize("who", [Phase.SOLVER, Phase.OPENING, Phase.HARNESS])
def test_a_kill_for_want_of_memory_is_lost(who: Phase, vmstat: Path, tmp_path: Path) -> None:
    child = killed(tmp_path, signal.SIGKILL, who)
    vmstat.write_text(VMSTAT.format(kills=4), encoding="ascii")
    assert child.determine_outcome() == Outcome("lost", BY_MEMORY)


def test_a_kill_without_want_of_memory_is_a_crash(vmstat: Path, tmp_path: Path) -> None:
    child = killed(tmp_path, signal.SIGKILL)
    assert child.determine_outcome() == Outcome("crashed", "killed by SIGKILL")


def test_another_signal_is_a_crash_whatever_the_memory(vmstat: Path, tmp_path: Path) -> None:
    child = killed(tmp_path, signal.SIGSEGV)
    vmstat.write_text(VMSTAT.format(kills=4), encoding="ascii")
    assert child.determine_outcome() == Outcome("crashed", "killed by SIGSEGV")


def test_a_kernel_that_does_not_count_leaves_a_kill_lost(vmstat: Path, tmp_path: Path) -> None:
    vmstat.write_text("nr_free_pages 1137\n", encoding="ascii")
    assert killed(tmp_path, signal.SIGKILL).determine_outcome() == Outcome("lost", BY_MEMORY)
    vmstat.unlink()
    assert killed(tmp_path, signal.SIGKILL).determine_outcome() == Outcome("lost", BY_MEMORY)
