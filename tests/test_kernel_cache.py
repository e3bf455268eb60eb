"""Kernels where Numba finds no folder to keep them in."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import dpbench
from dpbench import kernel_cache
from dpbench.kernel_cache import PACKAGE, list_numba_cache_folders, njit

KERNEL = """
from dpbench.kernel_cache import njit

@njit("f8(f8)", cache=True)
def twice(x):
    return 2.0 * x
"""
PROGRAM = """
import os, subprocess, sys
from twice import twice
print(twice(2.0), os.environ["NUMBA_CACHE_DIR"], sum(twice.stats.cache_hits.values()))
if "again" not in sys.argv:
    subprocess.run([sys.executable, __file__, "again"], check=True)
"""
SESSION = """
import importlib, sys
for module in sys.argv[1:]:
    importlib.import_module(module)
from dpbench.ship.estimation.estimator import shift_heading_near
shift_heading_near(0.0, 1.0), shift_heading_near(0, 1)
"""


@pytest.mark.slow
def test_kernels_are_kept_as_long_as_the_program_lives(tmp_path: Path) -> None:
    """In a folder of its own, for the processes that it starts too, and nothing is left of it."""
    (tmp_path / "twice.py").write_text(KERNEL, encoding="utf-8")
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    # Where Numba would write there are no folders, which stops root as well.
    (tmp_path / "__pycache__").touch()
    place = tmp_path / "tmp"
    place.mkdir()
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "TMPDIR": str(place)}
    paths = {"PYTHONPATH": str(Path(dpbench.__file__).parents[1])}
    environment = {name: v for name, v in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, str(tmp_path / "program.py")],
        env=environment | nowhere | paths,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    first, again = (line.split() for line in done.stdout.splitlines())
    assert (first[0], first[2]) == ("4.0", "0") and (again[0], again[2]) == ("4.0", "1")
    assert first[1] == again[1] and first[1].startswith(str(place))
    assert list(place.iterdir()) == []


@pytest.mark.slow
def test_a_session_in_python_announces_compilation_once(tmp_path: Path) -> None:
    """Not when kernels are cached, and not in a command or worker."""

    def run(folder: str, *modules: str) -> list[str]:
        command = [sys.executable, "-c", SESSION, *modules]
        cache = {"NUMBA_CACHE_DIR": str(tmp_path / folder)}
        done = subprocess.run(
            command, env=os.environ | cache, stderr=subprocess.PIPE, text=True, check=True
        )
        return done.stderr.splitlines()

    assert run("session") == [f"dpbench: {kernel_cache.COMPILING}"]
    assert run("session") == [] == run("command", "dpbench.cli")


def test_without_any_folder_they_are_compiled_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once a process; an error of another kind stays one."""

    def nowhere() -> Path:
        raise OSError

    def refusing(**options: object) -> object:
        if options["cache"]:
            raise RuntimeError("cannot cache function 'f': no locator available")
        return numba.njit

    monkeypatch.setattr(kernel_cache, "process_temporary_folder", nowhere)
    monkeypatch.setattr(kernel_cache, "_numba_njit", refusing)
    kernel_cache._use_temporary_numba_cache.cache_clear()
    try:
        assert njit(cache=True)(lambda x: x + 1)(1) == 2
    finally:
        kernel_cache._use_temporary_numba_cache.cache_clear()

    def broken(**options: object) -> object:
        raise RuntimeError("another")

    monkeypatch.setattr(kernel_cache, "_numba_njit", broken)
    with pytest.raises(RuntimeError, match="another"):
        njit(cache=True)(lambda x: x)


def test_the_folders_are_those_of_numba(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The one that is given alone, or the sources and the user's."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert list_numba_cache_folders() == [tmp_path]
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    assert list_numba_cache_folders()[0] == PACKAGE and len(list_numba_cache_folders()) == 2
