"""What campaigns that know nothing of each other share on a machine: its cores."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from dpbench.bench.workers import leases
from dpbench.bench.workers.leases import leased_core

pytestmark = pytest.mark.alone

HOLDING = """
from dpbench.bench.workers.leases import leased_core
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
