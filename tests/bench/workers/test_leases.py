"""What campaigns that know nothing of each other share on a machine: its cores, and its quiet."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.progress import Silent
from dpbench.bench.workers import leases
from dpbench.bench.workers.executor import WAITING
from dpbench.bench.workers.leases import leased_core

pytestmark = pytest.mark.slow

HEAD = """
title = "A suite for one test"
solvers = ["daqp"]
baseline_law = false
cell_limit_s = 60.0
rounds = 1
warmup_steps = 0
"""
LOOPS = HEAD + '[[closed_loop]]\nscenarios = ["paper"]\nsteps = 5\n'
REPLAYS = HEAD + '[[replay]]\nscenario = "paper"\nsteps = 5\n'
HOLDING = """
from dpbench.bench.workers.leases import ALONE, TOGETHER, leased_core, leased_machine
with {lease} as held:
    print(held, flush=True)
    input()
"""


@contextmanager
def holding(lease: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process that has a lease until it is killed, and what it got."""
    command = [sys.executable, "-c", HOLDING.format(lease=lease)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
        process.kill()


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leases of this test alone, also for the processes that it starts."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(leases, "tempfile", SimpleNamespace(gettempdir=lambda: str(tmp_path)))


@pytest.mark.alone  # What runs side by side has one core each.
def test_a_core_is_leased_to_one_process_at_a_time() -> None:
    """Others get others, as long as there are some; one that is killed gives its core back."""
    cores = sorted(os.sched_getaffinity(0))
    with holding("leased_core()") as (_, core):
        taken = int(core)
        with leased_core() as first, leased_core() as second:
            assert taken in cores and (first != taken or len(cores) == 1)
            # More work than cores: one of them has two.
            assert second in cores
    with leased_core() as core_again:
        assert core_again == taken == cores[0]


class Remarks(Silent):
    """A progress that counts how often a wait was said, and kills who is waited for."""

    def __init__(self, other: subprocess.Popen[str]) -> None:
        self.waits, self._other = 0, other

    def remark(self, text: str) -> None:
        """Count it, and end the other."""
        if text == WAITING:
            self.waits += 1
            self._other.kill()


@pytest.mark.parametrize(
    ("lease", "suite", "waits"),
    [
        ("ALONE", REPLAYS, True),
        ("TOGETHER", REPLAYS, True),
        ("ALONE", LOOPS, True),
        ("TOGETHER", LOOPS, False),
    ],
)
def test_replays_are_timed_while_no_other_campaign_runs_cells(
    lease: str, suite: str, waits: bool, tmp_path: Path
) -> None:
    """Who has to wait says so once, and goes on when the other was killed; nobody else waits."""
    (tmp_path / "tiny.toml").write_text(suite, encoding="utf-8")
    with holding(f"leased_machine({lease}, lambda: None)") as (other, held):
        assert held == "True"
        progress = Remarks(other)
        out = run_campaign(tmp_path / "tiny.toml", tmp_path / "out", progress=progress)
    assert progress.waits == waits
    runs = load_results(out).runs
    assert set(runs["outcome"]) == {"finished"}
    assert runs["concurrency"].dropna().eq(1).all()


def test_where_there_are_no_locks_replays_are_not_ranked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is known of others then, and `concurrency` says so."""
    nowhere = SimpleNamespace(gettempdir=lambda: str(tmp_path / "nowhere"))
    monkeypatch.setattr(leases, "tempfile", nowhere)
    (tmp_path / "tiny.toml").write_text(REPLAYS, encoding="utf-8")
    runs = load_results(run_campaign(tmp_path / "tiny.toml", tmp_path / "out")).runs
    assert runs["outcome"].tolist() == ["finished"] and runs["concurrency"].tolist() == [2]
