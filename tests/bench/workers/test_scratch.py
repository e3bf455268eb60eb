"""Room for logs: what a killed campaign left takes none."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dpbench.bench.workers import scratch
from dpbench.bench.workers.scratch import Scratch

HOLD = """
import sys, time
from pathlib import Path
from dpbench.temporary_folders import temporary_folder
with temporary_folder(Path(sys.argv[1])) as folder:
    (folder / "log").write_bytes(b"a log")
    print(folder, flush=True)
    time.sleep(600)
"""


@pytest.mark.slow
def test_places_are_cleared_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        left = Path(holder.stdout.readline().strip())
        os.kill(holder.pid, signal.SIGKILL)
    monkeypatch.setattr(scratch, "MEMORY", tmp_path)
    with Scratch(tmp_path):
        assert not left.exists()
