"""Engines that cannot be opened: one line, exit 2, nothing written."""

import sys
from pathlib import Path

import pytest

from dpbench import kernel_cache
from dpbench.bench.engines import open_engine
from dpbench.bench.engines.engine import SourceFiles
from dpbench.bench.progress import Silent
from dpbench.cli.main import main


def refused(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a run that exits with 2."""
    out = tmp_path / "out"
    assert main(["run", "smoke", "--out", str(out), *words]) == 2
    assert not out.exists()
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_engines_and_their_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "local or dask" in refused(["--engine", "slurm"], tmp_path, capsys)
    line = refused(["--scheduler", "tcp://127.0.0.1:1"], tmp_path, capsys)
    assert line.startswith("dpbench: --scheduler: found") and "--engine dask" in line
    both = ["--engine", "dask", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "1"]
    assert "--jobs: found 1 with --scheduler" in refused(both, tmp_path, capsys)


def test_without_the_extra_the_line_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in ("dask_engine", "dask_cluster"):
        monkeypatch.delitem(sys.modules, f"dpbench.bench.engines.{name}", raising=False)
    line = refused(["--engine", "dask"], tmp_path, capsys)
    assert "--engine: dask needs the " in line and " package, which is not installed" in line
    assert "pip install 'dpbench[cluster]'" in line and "or use the local engine" in line


@pytest.mark.parametrize("is_announced", [False, True])
def test_a_session_announces_the_compilation_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_announced: bool
) -> None:
    """A closed loop in the session compiles most kernels, and the campaign after it the others."""
    monkeypatch.setattr(kernel_cache._notice, "is_printed", is_announced)
    monkeypatch.setattr(open_engine, "has_compiled_kernels", lambda: False)
    remarks: list[str] = []
    progress = Silent()
    monkeypatch.setattr(progress, "remark", remarks.append)
    with open_engine.LocalEngine(1) as engine:
        engine.prepare(SourceFiles(tmp_path), [], progress)
    assert remarks == [kernel_cache.COMPILING] * (not is_announced)
