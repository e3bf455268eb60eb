"""Mistakes a person makes: one line with place, found and allowed, exit 2, nothing written."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from dpbench import (
    InputError,
    SolverUnavailableError,
    export_sequence,
    load_results,
    run_campaign,
)
from dpbench.cli.main import main
from dpbench.codegen.generate import generate_controller
from dpbench.scenario.problem_files import find_folder_of_shipped_problems, find_problem_path
from dpbench.solvers import plugins, table
from dpbench.solvers.table import Availability
from tests.cli.conftest import Say

VESSEL = find_problem_path("vessels", "supply_mss").read_text(encoding="utf-8")
SCENARIO = find_problem_path("scenarios", "rough").read_text(encoding="utf-8")
THRUSTERS = find_problem_path("vessels", "ratownik").read_text(encoding="utf-8")
HEAD = 'title = "x"\nsolvers = ["daqp"]\n'


def changed(text: str, key: str, line: str) -> str:
    new, count = re.subn(rf"^{key} = .*$", line, text, count=1, flags=re.M)
    assert count == 1
    return new


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (HEAD, ["x.toml: nothing to run; required: a table of runs"]),
        (HEAD + '[[closed_loop]]\nscenarios = ["papr"]\n', ["x.toml: scenario name", "paper"]),
        (
            HEAD + '[[closed_loop]]\nscenarios = ["my.toml"]\n',
            ["x.toml: scenario name: 'my.toml': no such file; required: a scenario file"],
        ),
        (
            HEAD + '[[replay]]\nscenario = "paper"\nsettings = ["hgh"]\n',
            ["x.toml: settings", "'hgh'", "high"],
        ),
        (SCENARIO, ["x.toml: found a scenario", "a suite", "--scenario"]),
        (VESSEL, ["x.toml: found a vessel", "a suite"]),
        (THRUSTERS, ["x.toml: found a vessel", "a suite"]),
        (HEAD + "[[replay]]\nscenario = ", ["x.toml: found invalid TOML", "end of document"]),
    ],
    ids=[
        "nothing to run",
        "unknown scenario",
        "no file",
        "settings",
        "scenario",
        "vessel",
        "thrusters",
        "cut",
    ],
)
def test_a_suite_that_cannot_be_run(
    text: str, parts: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuse: Say
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(text, encoding="utf-8")
    line = refuse("run", "x.toml")
    assert all(part in line for part in parts), line
    assert [path.name for path in tmp_path.iterdir()] == ["x.toml"]


@pytest.mark.parametrize(
    ("key", "number"), [("length_m", 0.0762), ("length_m", 76200), ("mass_kg", 6000.0)]
)
def test_a_ship_in_other_units_is_none(
    key: str, number: float, tmp_path: Path, refuse: Say
) -> None:
    path = tmp_path / "x.toml"
    path.write_text(changed(VESSEL, key, f"{key} = {number}"), encoding="utf-8")
    said = refuse("check", str(path))
    assert "length_m" in said and "m and kg" in said


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["run", "standrad"], ["standrad", "standard"]),
        (["run", "smoke", "--solver", "quadprgo"], ["quadprgo", "quadprog"]),
        (["run", "smoke", "--jobs", "99"], ["--jobs", "99"]),
        (["run", "smoke", "--settings", "hgh"], ["dpbench: --settings: found 'hgh'"]),
        (["report", "no/such/folder"], ["no/such/folder", "dpbench run"]),
        (["check", "no/such/file.toml"], ["no/such/file.toml", "no such file"]),
        (["run", "smoke", "--dry-run", "--wait", "-1"], ["dpbench: --wait: found -1.0; allowed"]),
        (["run", "smoke", "--dry-run", "--scheduler", "tcp://[::1]:1"], ["allowed: --engine dask"]),
        (["run", "smoke", "--dry-run", "--engine", "spark"], ["--engine: found 'spark'; allowed"]),
        (
            ["run", "smoke", "--solver", "unconstrained_clipped", "--policy", "warm"],
            ["smoke.toml: nothing to run for unconstrained_clipped", "the policy fresh"],
        ),
        (
            ["capability", str(find_problem_path("scenarios", "rough"))],
            ["rough.toml: found a scenario; required: a vessel"],
        ),
        (["init", "no_ship", "--sea", "4"], ["no_ship.toml does not exist; give --length"]),
        (["tune-solver", "osqp", "--dry-run", "--wait", "nan"], ["dpbench: --wait: found nan"]),
        (
            ["run", "smoke", "--dry-run", "--solver", "osqp[rho=[1,-1]]"],
            ["dpbench: --solver: osqp[rho]: found -1; allowed: above 0"],
        ),
        (["run"], ["SUITE: missing; required: SUITE or --sequence"]),
        (["capability", "osv", "--out", "edge"], ["--out: found edge without --solver"]),
        (["codegen", "calm", "--out", __file__], ["py: file exists; required: a folder"]),
        (
            ["codegen", "calm", "--out", f"{__file__}/c"],
            ["a path in which every parent is a folder"],
        ),
        (
            ["run", "--sequence", "paper-30-5", "--scenario", "calm", "--dry-run"],
            ["--scenario: found with --sequence; allowed: one of the two"],
        ),
    ],
)
def test_bad_input_is_one_line_and_exit_2(words: list[str], parts: list[str], refuse: Say) -> None:
    line = refuse(*words)
    assert all(part in line for part in parts), line


@pytest.mark.parametrize(
    ("call", "said", "words", "typed"),
    [
        (
            lambda: run_campaign("smoke", "out", wait_s=-1.0),
            "`wait_s`: found -1.0; ",
            ["run", "smoke", "--out", "out", "--wait", "-1"],
            "--wait: found -1.0; ",
        ),
        (
            lambda: run_campaign("smoke", "out", scheduler="tcp://127.0.0.1:1"),
            "allowed: `engine` dask",
            ["run", "smoke", "--out", "out", "--scheduler", "tcp://127.0.0.1:1"],
            "allowed: --engine dask",
        ),
        (
            lambda: export_sequence("paper-30-5", "out.npz", at=3, every=2),
            "`at`: found 3 with `steps` or `every`",
            ["export", "paper-30-5", "--out", "out.npz", "--at", "3", "--every", "2"],
            "--at: found 3 with --steps or --every",
        ),
        (
            lambda: run_campaign("smoke", "out", solvers=["quadprgo"]),
            "more: `list_solvers()`",
            ["run", "smoke", "--out", "out", "--solver", "quadprgo"],
            "more: `dpbench list solvers`",
        ),
        (
            lambda: run_campaign("smoke", "out", solvers=["osqp"], settings={"osqp": {"rho": 1.6}}),
            "below 1; give solver options in `solvers`, for example 'osqp[rho=1.6]'",
            ["run", "smoke", "--out", "out", "--solver", "osqp", "--settings", "osqp"],
            "below 1; give solver options in --solver, for example 'osqp[rho=1.6]'",
        ),
        (
            lambda: generate_controller("paper", "osqp", out="c", settings="mine"),
            "below 1; give solver options in `solver`, for example 'osqp[rho=1.6]'",
            ["codegen", "paper", "--out", "c", "--solver", "osqp", "--settings", "mine"],
            "below 1; give solver options in --solver, for example 'osqp[rho=1.6]'",
        ),
        (
            lambda: load_results("missing"),
            "required: a folder written by `run_campaign()`",
            ["report", "missing"],
            "required: a folder written by `dpbench run`",
        ),
        (
            lambda: run_campaign("smoke", sequence="paper-30-5"),
            "`suite`: found smoke with `sequence` paper-30-5",
            ["run", "smoke", "--sequence", "paper-30-5"],
            "SUITE: found smoke with --sequence paper-30-5",
        ),
        (
            lambda: run_campaign(find_folder_of_shipped_problems() / "vessels" / "osv.toml"),
            'use `run_campaign(SUITE, scenarios=["SCENARIO@FILE"])`',
            ["run", str(find_folder_of_shipped_problems() / "vessels" / "osv.toml")],
            "use `dpbench run SUITE --scenario SCENARIO@FILE`",
        ),
    ],
    ids=[
        "renamed",
        "option",
        "several",
        "listing",
        "own options",
        "settings of C code",
        "function",
        "positional",
        "arguments",
    ],
)
def test_a_mistake_is_named_as_the_user_made_it(
    call: Callable[[], object], said: str, words: list[str], typed: str, refuse: Say
) -> None:
    """By arguments and functions in Python, by options and commands on the command line."""
    with pytest.raises(InputError) as refused:
        call()
    assert said in str(refused.value) and "--" not in str(refused.value)
    line = refuse(*words)
    assert typed in line and said not in line


@pytest.mark.parametrize("words", [["list", "ship"], ["fly"]])
def test_an_unknown_word_is_named_as_it_was_typed(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words)
    (line,) = capsys.readouterr().err.splitlines()
    assert f"'{words[-1]}'" in line


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["list", "ship"], "KIND: found 'ship'; allowed: one of vessels, scenarios, "),
        (["run", "smoke", "--jobs", "x"], "--jobs: found 'x'; allowed: a whole number "),
        (["compare", "a", "b", "--margin", "x"], "--margin: found 'x'; allowed: a number "),
        (["run", "smoke", "--wait"], "--wait: found no value; allowed: one value "),
        (["run", "smoke", "--tls", "a", "b"], "--tls: wrong number of values; required: 3 "),
        (["run", "smoke", "--wait", "3", "--no-wait"], "--no-wait: found with --wait; allowed: "),
        (["run", "smoke", "--quiet=1"], "--quiet: found '1'; allowed: no value "),
        (["check"], "FILE: missing "),
        (["list", "vessels", "--all"], "unknown argument: --all (see dpbench list "),
    ],
    ids=lambda given: given[0] if isinstance(given, list) else "",
)
def test_a_mistake_in_the_words_has_the_form_of_others(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """As one in a file: the option, what was found, what is allowed."""
    with pytest.raises(SystemExit, match="2"):
        main(words)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"dpbench: {said}") and line.endswith(" --help)")


@pytest.mark.parametrize("words", [[], ["--dry-run"]])
def test_a_run_of_missing_solvers_alone_is_refused(
    words: list[str], refuse: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same in Python, and before the result folder is made."""
    missing = Availability(False, reason="not installed")
    monkeypatch.setattr(table, "find_solver_availability", lambda solver: missing)
    line = refuse("run", "smoke", "--solver", "quadprog", "--out", "out", *words)
    assert line.endswith("solver quadprog: not installed; run `pip install quadprog`")
    with pytest.raises(SolverUnavailableError):
        run_campaign("smoke", "out", solvers=["quadprog"])
    assert not Path("out").exists()


def test_wrong_options_of_a_plug_in_are_refused_before_the_run(
    refuse: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "_LOADED", {})
    plug_in = str(Path(__file__).parents[1] / "solvers" / "example_plugin.py")
    words = "--solver", "admm[tol=1]", "--solver-module", plug_in, "--out", "out"
    found = "--solver: admm[tol]: found an unknown option; allowed: tolerance"
    assert refuse("run", "smoke", *words).endswith(found)
    assert not Path("out").exists()
