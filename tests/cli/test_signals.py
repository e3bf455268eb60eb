"""A run that is ended from outside: one line, the exit code of the signal, nothing left behind."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import dpbench
from dpbench.temporary_folders import PREFIX

# A signal goes to all processes of a group, and a loaded machine may let it meet the fork server.
pytestmark = [pytest.mark.slow, pytest.mark.alone]

SUITE = """
title = "A suite for one test"
solvers = ["daqp", "quadprog", "osqp"]
baseline_law = false
cell_limit_s = 60.0
rounds = 20
warmup_steps = 0

[[closed_loop]]
scenarios = ["paper"]
steps = 20

[[replay]]
scenario = "rough"
"""
INT, TERM, HUP, KILL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL
LINE = "dpbench: interrupted; finished cells are kept; run the same command again to continue\n"


@pytest.fixture
def place() -> Iterator[Path]:
    """A temporary directory for the runs of a test, whose path has room for that of a socket."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def started(tmp_path: Path, place: Path) -> subprocess.Popen[str]:
    """A run that has finished some cells and is at work on others, in a group of its own."""
    (tmp_path / "suite.toml").write_text(SUITE, encoding="utf-8")
    package = str(Path(dpbench.__file__).parents[1])
    run = [sys.executable, "-m", "dpbench", "run", "suite.toml", "--out", "out"]
    process = subprocess.Popen(
        # A shell that runs the tests in the background ignores Ctrl-C, and nohup a hang-up.
        [
            sys.executable,
            "-c",
            f"import os, signal; [signal.signal(n, signal.SIG_DFL) for n in ({INT:d}, {HUP:d})]; "
            f"os.execv({run[0]!r}, {run!r})",
        ],
        cwd=tmp_path,
        env={**os.environ, "TMPDIR": str(place), "PYTHONPATH": package},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while process.poll() is None and not _is_replaying(tmp_path):
        time.sleep(0.05)
    return process


def _is_replaying(tmp_path: Path) -> bool:
    """True once closed loops are finished and the sequence of the replays is made."""
    cells = tmp_path / "out" / "cells"
    return any(cells.glob("part-*.parquet")) and any(cells.glob("exact-*.npz"))


def _folders(process: subprocess.Popen[str]) -> list[Path]:
    """The folders that a run holds by a lock, in memory and elsewhere."""
    places = []
    for link in Path(f"/proc/{process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since it was listed
            places.append(Path(os.readlink(link)))
    return [place for place in places if place.name.startswith(PREFIX)]


@pytest.mark.parametrize(
    ("signals", "whole_group"),
    [((TERM,), False), ((TERM,), True), ((HUP,), True), ((INT, INT), True), ((TERM, INT), False)],
)
def test_a_signal_ends_a_run_in_one_line(
    signals: tuple[int, ...], whole_group: bool, tmp_path: Path, place: Path
) -> None:
    process = started(tmp_path, place)
    folders = _folders(process)
    assert len(folders) == 2
    send = os.killpg if whole_group else os.kill
    for number in signals:
        send(process.pid, number)
        time.sleep(0.02)
    out, err = process.communicate(timeout=60)
    assert (err, process.returncode) == (LINE, 128 + signals[0])
    assert "Traceback" not in out
    left = [path.name for path in place.iterdir()]
    assert left == [f"dpbench-leases-{os.getuid()}"]
    assert not any(folder.exists() for folder in folders)


def test_what_a_killed_run_left_goes_with_the_next(tmp_path: Path, place: Path) -> None:
    process = started(tmp_path, place)
    folders = _folders(process)
    assert len(folders) == 2
    process.kill()
    process.communicate(timeout=60)
    again = [sys.executable, "-m", "dpbench", "run", "smoke", "--steps", "2", "--out", "out2"]
    again += ["--solver", "daqp", "--quiet"]
    package = str(Path(dpbench.__file__).parents[1])
    env = {**os.environ, "TMPDIR": str(place), "PYTHONPATH": package}
    subprocess.run(again, cwd=tmp_path, env=env, check=True, timeout=300)
    left = [path.name for path in place.iterdir()]
    assert left == [f"dpbench-leases-{os.getuid()}"]
    assert not any(folder.exists() for folder in folders)


def test_a_hang_up_that_is_ignored_stays_ignored() -> None:
    program = (
        "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from dpbench.bench.workers.interrupts import first_signal_only\n"
        "with first_signal_only() as interruption:\n"
        "    signal.raise_signal(signal.SIGHUP)\n"
        "print(interruption.signal)\n"
    )
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("0\n", "")
