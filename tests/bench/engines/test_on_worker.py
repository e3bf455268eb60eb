"""A worker of a cluster by itself: it looks at versions, and leaves nothing behind."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from dpbench.bench.engines import on_worker
from dpbench.bench.engines.on_worker import (
    CampaignContext,
    TaskEndedError,
    interrupt_tasks,
    run_cells,
)
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.workers.child import start_forkserver
from dpbench.bench.workers.jobs import CellBatch, CellJob, Result
from dpbench.solvers.table import find_solver_availability
from dpbench.temporary_folders import PREFIX, make_temporary_folder_for_block

pytestmark = pytest.mark.slow

DYING = """
import os, signal
from dpbench.bench.engines import on_worker

def dying(*given, **more):
    os.kill(os.getpid(), signal.SIGKILL)

on_worker.CellExecutor.submit = dying
on_worker.make_files(on_worker.CampaignContext(), print, {"a.npz": ""}, None, isolated=False)
"""


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder with a short path: that of a socket has no more than 108 characters."""
    with TemporaryDirectory() as name:
        yield Path(name)


def test_what_a_killed_worker_left_goes_with_the_next_task(place: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", DYING],
        env=os.environ | {"TMPDIR": str(place)},
        capture_output=True,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    leases = f"dpbench-leases-{os.getuid()}"
    left = {path.name for path in place.glob("dpbench-*")} - {leases}
    assert left, "nobody tidied up"
    with make_temporary_folder_for_block(place) as folder:
        assert {path.name for path in place.glob("dpbench-*")} == {leases, folder.name}


@pytest.fixture
def jobs(suite: Path) -> list[CellJob]:
    planned = RunRequest(suite=str(suite), solvers=["daqp"]).make_plan().cells
    return [CellJob(p, p.cell.key, find_solver_availability("daqp"), "machine") for p in planned]


def results_of(jobs: list[CellJob]) -> list[Result]:
    batch = CellBatch("closed loops", jobs)
    return run_cells(CampaignContext(), batch, {}, alone=False, concurrency=1)


def test_a_worker_with_another_solver_does_not_run_it(jobs: list[CellJob]) -> None:
    for job in jobs:
        job.library = replace(job.library, version="0.0.1")
    results = results_of(jobs)
    assert all(result.outcome.outcome == "lost" for result in results) and len(results) == len(jobs)
    assert {"0.0.1 where the campaign was started" in r.outcome.detail for r in results} == {True}


def test_an_ended_task(jobs: list[CellJob], place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The socket of the fork server stays as long as this process.
    start_forkserver()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    running, ended = threading.Event(), threading.Event()

    def waiting(*given: object, **more: object) -> None:
        running.set()
        while True:
            ended.wait(0.01)

    monkeypatch.setattr(on_worker.CellExecutor, "submit", waiting)
    became: list[BaseException] = []

    def task() -> None:
        try:
            results_of(jobs[:1])
        except TaskEndedError as error:
            became.append(error)

    thread = threading.Thread(target=task)
    thread.start()
    assert running.wait(60.0)
    interrupt_tasks()
    thread.join()
    assert len(became) == 1
    assert not list(place.glob(f"{PREFIX}*"))
    interrupt_tasks()
