"""Solvers of third parties: from a file, from an entry point, and through qpsolvers by name."""

import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import qpsolvers

from dpbench import list_solvers
from dpbench.errors import (
    InputError,
    PolicyError,
    SettingsError,
    SolverUnavailableError,
    UnknownNameError,
)
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Status
from dpbench.solvers import plugins
from dpbench.solvers.open import open_workspace
from dpbench.solvers.settings import describe_option_presets, has_distinct_tolerance_presets
from dpbench.solvers.table import (
    find_solver_availability,
    find_solver_record,
    list_all_solver_names,
    load_plugin_solver_from_file,
)
from tests.solvers.conftest import solve_qp

EXAMPLE = Path(__file__).with_name("example_plugin.py")
TEXT = EXAMPLE.read_text()


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch):
    """Each test starts without plug-ins and leaves none behind."""
    monkeypatch.setattr(plugins, "_LOADED", {})
    plugins._find_plugin_entry_points.cache_clear()
    yield
    plugins._find_plugin_entry_points.cache_clear()


def test_the_example_is_short():
    assert len(TEXT.splitlines()) <= 30


def test_a_file_adds_a_solver(sequence):
    row = load_plugin_solver_from_file(EXAMPLE)
    assert (row.name, row.extra) == ("admm", "plugin")
    assert (
        "admm" in list_all_solver_names()
        and find_solver_record("admm") is row
        and find_solver_availability("admm").ok
    )
    workspace = open_workspace("admm", settings="high")
    assert workspace.route == "native" and workspace.setup_every_step
    for step, answer in zip(sequence.steps, sequence.answers(workspace), strict=True):
        assert answer.status is Status.SOLVED
        # Residuals of 1e-9 grow by the conditioning of the problem, some hundred.
        exact = certify(sequence.base.at(step)).z
        np.testing.assert_allclose(answer.z, exact, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_files_version_is_its_content(tmp_path):
    file, versions = tmp_path / "mine.py", []
    for text in (TEXT, TEXT, TEXT + "# changed\n"):
        file.write_text(text)
        load_plugin_solver_from_file(file)
        versions.append(find_solver_availability("admm").version)
    assert versions[0] == versions[1] != versions[2]


def test_the_levels_of_a_plugin_reaches_it(sequence):
    load_plugin_solver_from_file(EXAMPLE)
    assert has_distinct_tolerance_presets("admm")
    assert "high: tolerance=1e-09" in describe_option_presets("admm")
    workspaces = (open_workspace("admm", settings=s) for s in ({"tolerance": 0.1}, "low", "high"))
    few, more, most = (solve_qp(workspace, sequence.base).iterations for workspace in workspaces)
    assert few < more < most
    with pytest.raises(SettingsError, match="hihg"):
        open_workspace("admm", settings="hihg")
    with pytest.raises(PolicyError, match="warm"):
        open_workspace("admm", policy="warm")


def test_a_plugin_of_yesterday_is_read(tmp_path):
    old = TEXT.replace("LEVELS = ", "LADDER = ").replace('family="first order", ', "")
    file = tmp_path / "old.py"
    refused = 'refused={("native", "warm"): "it has no start"}'
    file.write_text(old.replace("detects_infeasibility=False", refused))
    with pytest.warns(FutureWarning, match=r"old.py: LADDER is now called LEVELS$"):
        row = load_plugin_solver_from_file(file)
    assert row.family == "not stated"
    assert "high: tolerance=1e-09" in describe_option_presets("admm")
    assert row.state_why_policy_is_unavailable("native", "warm") == "it has no start"
    assert row.state_why_policy_is_unavailable("native", "reuse") == "not offered"


def test_the_options_of_a_plugins_function_are_listed():
    load_plugin_solver_from_file(EXAMPLE)
    assert list_solvers().options("admm") == {"native": ["tolerance"]}


@pytest.mark.parametrize("function", ["lambda qp, **options: None", "min"])
def test_unknown_options_of_a_function_are_not_refused(tmp_path, function):
    """A function may take any option, or have no signature."""
    file = tmp_path / "own.py"
    file.write_text(
        "from dpbench import opener\nfrom dpbench.solvers.plugins import solver_record\n"
        f'RECORD = solver_record("own", method="any")\nopen = opener("own", {function})\n'
    )
    load_plugin_solver_from_file(file, tried=True)
    assert list_solvers().options("own") == {"native": []}
    open_workspace("own", settings={"key": 1})


def test_what_a_plugin_raises_is_an_answer(sequence):
    load_plugin_solver_from_file(EXAMPLE)
    with pytest.raises(SettingsError, match=r"found an unknown option; allowed: tolerance$"):
        open_workspace("admm", settings={"tolerances": 1.0})
    workspace = open_workspace("admm", settings={"tolerance": None})
    workspace.setup(sequence.base)
    assert workspace.read().detail == "read before solve"
    workspace.solve()
    answer = workspace.read()
    assert answer.status is Status.ERROR
    assert "NoneType" in answer.detail


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "no such file"),
        ("x = 1", "RECORD: missing"),
        ("import os; os._exit(0)", r"ended its process when imported \(exit code 0\)"),
        # Each starts a process.
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("1/0", "ZeroDivisionError"),
                ("from example import RECORD", "'example'; install the package of this module"),
                (
                    TEXT.replace('opener("admm"', 'opener("daqp"'),
                    r"mine\.py: opener: name: found 'daqp'; allowed: a name that no .* has$",
                ),
                (TEXT.replace("open = ", "shut = "), "open: missing; required: a function"),
                (TEXT.replace('"admm", method', '"daqp", method'), "RECORD.name.*'daqp'"),
                (
                    TEXT.replace("first order", "first ordre"),
                    "family: found 'first ordre'; allowed: act",
                ),
                (
                    TEXT.replace("method=", 'policies=("warmest",), method=', 1),
                    r"policies: found \('warmest',\); allowed: one or more of fresh, reuse, warm",
                ),
                ("raise SystemExit(0)", "SystemExit: 0"),
                ("raise type('Own', (BaseException,), {})('two\\nlines')", "Own: two lines"),
                (
                    "import signal; signal.raise_signal(signal.SIGSEGV)",
                    r"ended its process when imported \(SIGSEGV\)",
                ),
                (TEXT.replace('"admm", method', '"../../x", method'), "RECORD.name.*x'"),
                (TEXT.replace('"admm", method', '"a\\x1b", method'), "RECORD.name.*x1b'"),
            )
        ),
    ],
)
def test_what_is_no_plugin_is_refused(tmp_path, text, words):
    file = tmp_path / "mine.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_plugin_solver_from_file(file)
    assert "mine.py" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.slow
def test_an_import_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(plugins, "TRIAL_S", 1.0)
    file = tmp_path / "mine.py"
    file.write_text("while True:\n    pass\n")
    with pytest.raises(InputError, match=r"mine.py: found an import that takes more than 1 s"):
        load_plugin_solver_from_file(file)


@pytest.mark.slow
def test_two_files_cannot_have_one_name(tmp_path):
    load_plugin_solver_from_file(EXAMPLE)
    copy = tmp_path / "other.py"
    copy.write_text(TEXT)
    with pytest.raises(InputError, match="example_plugin"):
        load_plugin_solver_from_file(copy)


def test_an_entry_point_adds_a_solver(monkeypatch, tmp_path):
    (tmp_path / "their_solver.py").write_text(TEXT)
    folder = tmp_path / "their_solver-2.5.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: their-solver\nVersion: 2.5\n")
    (folder / "entry_points.txt").write_text(
        "[dpbench.solvers]\nadmm = their_solver\nbroken = their_solver:nothing\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert {"admm", "broken"} <= set(list_all_solver_names())
    assert find_solver_availability("admm").version == "2.5"
    assert open_workspace("admm").solver == "admm"
    with pytest.raises(InputError, match=r"entry point broken.*nothing"):
        open_workspace("broken")
    monkeypatch.delitem(sys.modules, "their_solver")


def test_a_solver_that_only_qpsolvers_knows_works_by_its_name(monkeypatch, sequence):
    inner = qpsolvers.solvers.solve_function["quadprog"]
    monkeypatch.setitem(qpsolvers.solvers.solve_function, "brandnew", inner)
    monkeypatch.setattr(qpsolvers, "available_solvers", [*qpsolvers.available_solvers, "brandnew"])
    assert find_solver_record("brandnew").policies_by_route == {"qpsolvers": ("fresh",)}
    assert (
        find_solver_availability("brandnew").version == f"qpsolvers {metadata.version('qpsolvers')}"
    )
    workspace = open_workspace("brandnew")
    answer = solve_qp(workspace, sequence.base)
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z, certify(sequence.base).z, rtol=0, atol=1e-9)


def test_a_solver_that_qpsolvers_serves_but_does_not_find_says_so():
    assert not find_solver_availability("gurobi").ok
    assert find_solver_availability("gurobi").reason.endswith("`pip install 'qpsolvers[gurobi]'`")
    with pytest.raises(
        SolverUnavailableError, match=r"gurobi: run `pip install 'qpsolvers\[gurobi\]'`$"
    ):
        open_workspace("gurobi")
    with pytest.raises(SolverUnavailableError, match=r"nppro: see the documentation of qpsolvers$"):
        open_workspace("nppro")
    with pytest.raises(UnknownNameError):
        find_solver_record("gurobii")
