"""Mistakes a person makes: one line with place, found and allowed, exit 2, nothing written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dpbench.cli.main import main
from dpbench.scenario.problem_files import problem_path

VESSEL = problem_path("vessels", "supply_mss").read_text(encoding="utf-8")
SCENARIO = problem_path("scenarios", "rough").read_text(encoding="utf-8")
HEAD = 'title = "x"\nsolvers = ["daqp"]\n'


def changed(text: str, key: str, line: str) -> str:
    """A file with another line for a key of it."""
    new, count = re.subn(rf"^{key} = .*$", line, text, count=1, flags=re.M)
    assert count == 1
    return new


def mistake(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a command that exits with 2."""
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (HEAD, ["x.toml: found nothing to run", "[[closed_loop]]"]),
        (HEAD + '[[closed_loop]]\nscenarios = ["papr"]\n', ["x.toml: scenario name", "paper"]),
        (
            HEAD + '[[replay]]\nscenario = "paper"\nsettings = ["hgh"]\n',
            ["x.toml: settings", "'hgh'", "high"],
        ),
        (SCENARIO, ["x.toml: found a scenario", "a suite", "--scenario"]),
        (VESSEL, ["x.toml: found a vessel", "a suite"]),
        (HEAD + "[[replay]]\nscenario = ", ["x.toml: found no TOML", "end of document"]),
    ],
    ids=["nothing to run", "unknown scenario", "settings", "scenario", "vessel", "cut"],
)
def test_a_suite_that_cannot_be_run(
    text: str,
    parts: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The line names the file, and no result folder is begun."""
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(text, encoding="utf-8")
    line = mistake(["run", "x.toml"], capsys)
    assert all(part in line for part in parts), line
    assert [path.name for path in tmp_path.iterdir()] == ["x.toml"]


@pytest.mark.parametrize(
    ("key", "number"), [("length_m", 0.0762), ("length_m", 76200), ("mass_kg", 6000.0)]
)
def test_a_ship_in_other_units_is_none(
    key: str, number: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Length in km or mm, mass in t: not those of one ship."""
    path = tmp_path / "x.toml"
    path.write_text(changed(VESSEL, key, f"{key} = {number}"), encoding="utf-8")
    said = mistake(["check", str(path)], capsys)
    assert "length_m" in said and "m and kg" in said


def test_settings_of_the_command_line_are_not_those_of_the_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each is named where it stands."""
    line = mistake(["run", "smoke", "--settings", "hgh"], capsys)
    assert line.startswith("dpbench: --settings: found 'hgh'")


def test_what_is_no_kind_of_list_is_named_as_it_was_typed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """No s is added to it."""
    with pytest.raises(SystemExit, match="2"):
        main(["list", "ship"])
    assert "'ship'" in capsys.readouterr().err
