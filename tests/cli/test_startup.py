"""Commands that answer at once load no library that they can do without."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from dpbench.scenario.problem_files import find_problem_path

HEAVY = {"pandas", "numba", "scipy.optimize", "scipy.sparse", "osqp"}
"""Packages that take a quarter of a second or more to import."""
_CALLED = """
import contextlib, io, json, sys
from dpbench.cli.main import main
for command in json.loads(sys.argv[1]):
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as said:
        main(command)
    print(json.dumps([said.getvalue(), sorted(sys.modules)]))
"""


def _loaded(*commands: list[str]) -> list[tuple[str, set[str]]]:
    """Run commands one after the other in a new process.

    Return for each what it printed, and the heavy modules that it or one before loaded.
    """
    program = [sys.executable, "-c", _CALLED, json.dumps(commands)]
    done = subprocess.run(program, stdout=subprocess.PIPE, text=True, check=True)
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    return [(printed, HEAVY & set(modules)) for printed, modules in answers]


@pytest.mark.slow
def test_a_quick_command_loads_nothing_heavy() -> None:
    shown = {
        "--help": "worst-case",
        "list vessels": "osv",
        "list scenarios": "turn",
        "list sequences": "turn-60-10",
        "list solvers": "paper_active_set",
        "check nonsense": "",
    }
    answers = _loaded(*(command.split() for command in shown))
    for (command, part), (printed, heavy) in zip(shown.items(), answers, strict=True):
        assert part in printed
        assert not heavy, command


@pytest.mark.slow
def test_a_mistake_in_a_file_is_answered_before_anything_heavy(tmp_path: Path) -> None:
    commands = []
    for kind, name in (("scenarios", "turn"), ("vessels", "osv")):
        text = find_problem_path(kind, name).read_text(encoding="utf-8")
        bad = tmp_path / f"{name}.toml"
        bad.write_text(f"mistake = 1\n{text}", encoding="utf-8")
        commands.append(["check", str(bad)])
    assert _loaded(*commands) == [("", set())] * 2
