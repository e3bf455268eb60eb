"""What a worker of a cluster does by itself: it leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dpbench.bench.workers.scratch import scratch_folder

pytestmark = pytest.mark.alone

DYING = """
import os, signal
from dpbench.bench.engines import on_worker

def dying(*given, **more):
    os.kill(os.getpid(), signal.SIGKILL)

on_worker.Bench.make_files = dying
on_worker.make_files(on_worker.Order(), print, {"a.npz": ""}, None)
"""


def test_what_a_killed_worker_left_goes_with_the_next_task(tmp_path: Path) -> None:
    """By the lock of its folder, as that of a killed campaign."""
    done = subprocess.run(
        [sys.executable, "-c", DYING],
        env=os.environ | {"TMPDIR": str(tmp_path)},
        capture_output=True,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    leases = f"dpbench-leases-{os.getuid()}"
    left = {path.name for path in tmp_path.glob("dpbench-*")} - {leases}
    assert left, "nobody tidied up"
    with scratch_folder(tmp_path) as folder:
        assert {path.name for path in tmp_path.glob("dpbench-*")} == {leases, folder.name}
