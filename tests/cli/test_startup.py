"""Commands that answer at once load no library that they can do without."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from dpbench.scenario.problem_files import problem_path

HEAVY = {"pandas", "numba", "scipy.optimize", "scipy.sparse", "osqp"}
"""Packages that take a quarter of a second or more to import."""
_CALLED = """
import contextlib, io, json, sys
from dpbench.cli.main import main
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as said:
    code = main(sys.argv[1:])
print(json.dumps([said.getvalue(), sorted(sys.modules)]))
"""


def _loaded(*arguments: str) -> tuple[str, set[str]]:
    """Run a command in a new process; return what it printed, and the heavy modules it loaded."""
    command = [sys.executable, "-c", _CALLED, *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    printed, modules = json.loads(done.stdout.splitlines()[-1])
    return printed, HEAVY & set(modules)


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("--help", "worst-case"),
        ("list vessels", "osv"),
        ("list scenarios", "turn"),
        ("list sequences", "turn-60-10"),
        ("list solvers", "paper_active_set"),
        ("check nonsense", ""),
    ],
)
def test_a_quick_command_loads_nothing_heavy(command: str, shown: str) -> None:
    printed, heavy = _loaded(*command.split())
    assert shown in printed
    assert not heavy


@pytest.mark.parametrize("kind", ["scenarios", "vessels"])
def test_a_mistake_in_a_file_is_answered_before_anything_heavy(kind: str, tmp_path: Path) -> None:
    name = {"scenarios": "turn", "vessels": "osv"}[kind]
    text = problem_path(kind, name).read_text(encoding="utf-8")
    bad = tmp_path / "bad.toml"
    bad.write_text(f"mistake = 1\n{text}", encoding="utf-8")
    assert _loaded("check", str(bad)) == ("", set())
