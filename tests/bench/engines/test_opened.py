"""Engines that cannot be opened: one line, exit 2, nothing written."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from dpbench.bench.engines.leased_core import leased_core
from dpbench.cli.main import main


def refused(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a run that exits with 2."""
    out = tmp_path / "out"
    assert main(["run", "smoke", "--out", str(out), *words]) == 2
    assert not out.exists()
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_engines_and_their_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An unknown one, a scheduler without dask, a scheduler and a count of workers."""
    assert "local or dask" in refused(["--engine", "slurm"], tmp_path, capsys)
    line = refused(["--scheduler", "tcp://127.0.0.1:1"], tmp_path, capsys)
    assert line.startswith("dpbench: --scheduler: found") and "--engine dask" in line
    both = ["--engine", "dask", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "1"]
    assert "--jobs: found 1 with --scheduler" in refused(both, tmp_path, capsys)


def test_without_the_extra_the_line_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As it is where neither dask nor distributed can be imported."""
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in ("dask_engine", "dask_cluster"):
        monkeypatch.delitem(sys.modules, f"dpbench.bench.engines.{name}", raising=False)
    line = refused(["--engine", "dask"], tmp_path, capsys)
    assert line.startswith("dpbench: --engine: found dask") and "dpbench[cluster]" in line


HOLDING = "from dpbench.bench.engines.leased_core import leased_core\n"
HOLDING += "with leased_core() as core:\n    print(core, flush=True)\n    input()\n"


def test_a_core_is_leased_to_one_process_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others get others, as long as there are some; one that is killed gives its core back."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    cores = sorted(os.sched_getaffinity(0))
    command = [sys.executable, "-c", HOLDING]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as holder:
        assert holder.stdout is not None
        taken = int(holder.stdout.readline())
        with leased_core() as first, leased_core() as second:
            assert taken in cores and (first != taken or len(cores) == 1)
            # More work than cores: one of them has two.
            assert second in cores
        holder.kill()
    with leased_core() as core:
        assert core == taken == cores[0]
