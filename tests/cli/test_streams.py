"""Printing where nothing can be shown: closed streams and pipes, ASCII, a full disk."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import dpbench

pytestmark = pytest.mark.slow

ASCII = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def _shell(script: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a line of shell in which `dpbench` is the command line of this tree."""
    environment = {"PYTHONPATH": str(Path(dpbench.__file__).parents[1]), **variables}
    script = f'dpbench() {{ "{sys.executable}" -m dpbench "$@"; }}\n{script}'
    command = ["bash", "-c", script]
    return subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )


def test_a_reader_that_goes_away_ends_it_without_a_word() -> None:
    for command, code in (("list scenarios", 1), ("check paper --quick", 141)):
        done = _shell(f"dpbench {command} | true; echo ${{PIPESTATUS[0]}}")
        assert (done.stdout, done.stderr) == (f"{code}\n", "")


@pytest.mark.parametrize("closed", [">&-", "<&- >&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_change_nothing_else(closed: str) -> None:
    assert _shell(f"dpbench list solvers {closed}").returncode == 0
    done = _shell(f"dpbench report no/such/folder {closed}")
    lines = done.stderr.splitlines()
    assert done.returncode == 2 and len(lines) == ("2>&-" not in closed)


def test_a_terminal_of_ascii_shows_the_same_numbers() -> None:
    plain, full = _shell("dpbench check paper", **ASCII), _shell("dpbench check paper")
    assert plain.returncode == full.returncode == 0 and plain.stderr.isascii()
    expected = full.stdout
    for sign, nearest in {"°": "deg", "±": "+-", "·": "*", "²": "2"}.items():
        assert sign in expected
        expected = expected.replace(sign, nearest)
    assert plain.stdout == expected


def test_a_full_disk_is_one_line() -> None:
    done = _shell("dpbench check paper-30-5 > /dev/full")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "no space left on device" in done.stderr


def test_python_without_docstrings_is_refused_in_one_line() -> None:
    done = _shell("dpbench list solvers", PYTHONOPTIMIZE="2")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "PYTHONOPTIMIZE" in done.stderr
    assert _shell("dpbench check paper-30-5", PYTHONOPTIMIZE="1").returncode == 0
