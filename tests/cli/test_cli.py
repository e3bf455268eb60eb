"""The command line: exit codes, one line for a person's mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpbench.cli import check_ship
from dpbench.cli.main import main
from dpbench.scenario.problem_files import problem_path


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("vessels", "supply_fs99", "a vessel"),
        ("scenarios", "rough", "a scenario of 2000 steps"),
        ("suites", "smoke", "a suite of"),
    ],
)
def test_check_says_what_a_file_is(
    kind: str,
    name: str,
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`dpbench check` recognises vessels, scenarios and suites by their tables."""
    monkeypatch.setattr(check_ship, "is_held", lambda trial, offset_m, sides: False)
    assert main(["check", str(problem_path(kind, name))]) == 0
    assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["run", "standrad"], ["standrad", "standard"]),
        (["run", "smoke", "--solver", "quadprgo"], ["quadprgo", "quadprog"]),
        (["run", "smoke", "--jobs", "99"], ["--jobs", "99"]),
        (["report", "no/such/folder"], ["no/such/folder", "dpbench run"]),
        (["check", "no/such/file.toml"], ["no/such/file.toml", "no such file"]),
        (["fly"], ["fly", "run"]),
        (["run"], ["suite"]),
    ],
)
def test_bad_input_is_one_line_and_exit_2(
    arguments: list[str], parts: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Bad input prints one line that names what was found and what is allowed, and exits with 2."""
    try:
        code = main(arguments)
    except SystemExit as exit_:
        code = int(exit_.code or 0)
    assert code == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert all(part in lines[0] for part in parts), lines[0]


def test_an_unrecognised_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A TOML file that is none of the three kinds is refused with what would be one."""
    path = tmp_path / "odd.toml"
    path.write_text("[spam]\neggs = 1\n", encoding="utf-8")
    assert main(["check", str(path)]) == 2
    assert "[[thrusters]] (a vessel)" in capsys.readouterr().err
