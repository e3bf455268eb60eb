"""The table of solvers, who is available, and how a workspace is opened."""

import dataclasses
import importlib.metadata
import re
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
import qpsolvers

import dpbench
from dpbench.errors import DpbenchError, PolicyError, SolverUnavailableError, UnknownNameError
from dpbench.solvers import table
from dpbench.solvers.libraries import NATIVE, THROUGH_QPSOLVERS
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import (
    TABLE,
    block_imports_of_other_solvers,
    find_solver_availability,
    find_solver_record,
    get_qpsolvers_adapter,
    list_all_solver_names,
)
from tests.solvers.conftest import run_program

PROMISED = (
    "clarabel cvxopt daqp ecos elastiqp elastiqp_pdal highs hpipm hpipm_ocp jaxopt kvxopt osqp "
    "piqp piqp_multistage piqp_sparse proxqp proxqp_sparse pyqpmad qoco qpalm qpax qpoases qtqp "
    "quadprog scs sip superadmm"
)


def test_every_promised_solver_is_in_the_table():
    own = [name for name, row in TABLE.items() if row.extra == "own"]
    assert {"paper_active_set", "unconstrained_clipped"} <= set(own)
    assert {*PROMISED.split(), *own} <= set(TABLE) <= set(list_all_solver_names())
    assert list(list_all_solver_names()) == sorted(list_all_solver_names())


def test_no_adapter_is_hidden_by_another():
    for name in THROUGH_QPSOLVERS:
        assert TABLE[name].default_route == "qpsolvers"
    assert all("native" in TABLE[name].routes for name in NATIVE)


def test_a_distribution_is_declared_where_its_record_says():
    root = Path(dpbench.__file__).parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    declared = {"core": project["dependencies"], **project["optional-dependencies"]}
    for row in TABLE.values():
        if row.extra != "own":
            names = [re.split(r"[<>=]", asked)[0] for asked in declared[row.extra]]
            assert row.distribution in names, row.name


def test_an_installed_solver_has_name_version_and_form_of_its_record(installed):
    row = find_solver_record(installed)
    if "qpsolvers" in row.routes:
        assert get_qpsolvers_adapter(installed).qpsolvers_key in qpsolvers.available_solvers
    if row.extra != "own":
        assert find_solver_availability(installed).version == importlib.metadata.version(
            row.distribution
        )
    assert open_workspace(installed).form == row.form


def test_a_missing_distribution_is_listed_with_reason_and_remedy(monkeypatch):

    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(table, "_get_installed_package_version", missing)
    reason = "casadi is not installed; run `pip install casadi`"
    assert find_solver_availability("hpipm").reason == reason
    assert find_solver_availability("daqp").reason.endswith("run `pip install daqp`")
    with pytest.raises(SolverUnavailableError, match=r"qpax is not installed.*pip install qpax"):
        open_workspace("qpax")


@pytest.mark.parametrize("raised", ["ImportError", "RuntimeError", "BaseException"])
def test_a_library_that_fails_to_import_is_listed_with_its_words(monkeypatch, tmp_path, raised):
    (tmp_path / "daqp.py").write_text(f"raise {raised}('no such  instruction')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "daqp", raising=False)
    daqp = find_solver_availability("daqp")
    assert not daqp.ok
    assert daqp.reason == f"importing daqp failed: {raised}: no such instruction"


def test_unknown_names_are_refused():
    with pytest.raises(UnknownNameError, match=r"quadprgo.*quadprog"):
        open_workspace("quadprgo")
    with pytest.raises(UnknownNameError, match=r"allowed: 'osqp' with settings={'rho': 1\.0}"):
        open_workspace("osqp[rho=1.0]")


@pytest.mark.parametrize(
    ("solver", "route", "policy", "words"),
    [
        ("daqp", None, "reuse", "nothing can be reused"),
        ("clarabel", None, "warm", "ignores a start"),
        ("qpalm", None, "warm", "setting `x`"),
        ("daqp", None, "hot", "allowed: fresh"),
        ("pyqpmad", "native", "fresh", "allowed: qpsolvers"),
        ("qoco", "qpsolvers", "fresh", "allowed: native"),
        ("clarabel", "native", "warm", "no interface for a starting point"),
        ("piqp", "native", "warm", "no interface for a starting point"),
        ("quadprog", "native", "warm", "unconstrained optimum"),
        ("highs", "native", "warm", "to the last bit"),
        ("paper_active_set", "qpsolvers", "fresh", "allowed: native"),
    ],
)
def test_routes_and_policies_that_do_not_exist_are_refused(solver, route, policy, words):
    with pytest.raises(PolicyError, match=words):
        open_workspace(solver, route=route, policy=policy)


def test_the_default_route_is_the_solvers_own():
    routes = {"daqp": "qpsolvers", "piqp_sparse": "native", "paper_active_set": "native"}
    assert {solver: open_workspace(solver).route for solver in routes} == routes


def test_native_workspaces_set_up_anew_only_when_fresh(configuration):
    fresh = configuration.route == "native" and configuration.policy == "fresh"
    assert configuration.open().setup_every_step == fresh


def test_no_fact_without_a_source():
    for row in TABLE.values():
        facts = dataclasses.asdict(row.project)
        in_c = facts.pop("c_settings")
        assert in_c is None or all(in_c[k] for k in ("struct", "defaults", "source")), row.name
        for fact in facts.values():
            assert (fact["value"] == "not stated") == (fact["source"] == "")
        assert facts["licence"]["source"], row.name
        assert facts["language"]["source"], row.name


def test_settings_in_c_have_the_names_of_the_options():
    row = TABLE["osqp"]
    headers = Path(import_module("osqp").__file__).parent.rglob("osqp_api_*.h")
    text = "".join(header.read_text(encoding="utf-8") for header in headers)
    in_c = row.project.c_settings
    assert re.search(rf"void {in_c.defaults}\({in_c.struct}\s*\*\s*\w+\)", text)
    fields = text.split(f"}} {in_c.struct};")[0].rsplit("typedef struct", 1)[1]
    assert f" {in_c.warm_start}(" in text
    policy = in_c.list_policy_options("reuse").keys()
    for option in policy | {key for level in row.levels.values() for key in level}:
        assert re.search(rf"\b{option};", fields), option


def test_a_solver_to_choose_instead_is_of_the_table_and_chosen_itself():
    for row in TABLE.values():
        if row.choose_instead:
            assert not TABLE[row.choose_instead].choose_instead


def test_isolation_comes_before_qpsolvers():
    open_workspace("daqp")
    with pytest.raises(DpbenchError, match="too late"):
        block_imports_of_other_solvers("daqp")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "loaded"),
    [("daqp", "daqp"), ("sip", "cvxopt sip_qp_python"), ("clarabel", "clarabel"), ("admm", "")],
)
def test_an_isolated_process_loads_one_library(solver, loaded):
    program = f"""
import sys
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import TABLE, block_imports_of_other_solvers
from dpbench.solvers.table import load_plugin_solver_from_file
load_plugin_solver_from_file({str(Path(__file__).with_name("example_plugin.py"))!r})
from dpbench.qp.program import QuadraticProgram
block_imports_of_other_solvers({solver!r})
import scipy.linalg
I = scipy.linalg.block_diag(1.0, 1.0)  # SciPy looks at JAX where that is in sys.modules
workspace = open_workspace({solver!r})
workspace.setup(QuadraticProgram(I, [-3.0, 0.0], I, [-1, -1], [1, 1], [-2, -2], [2, 2]))
workspace.solve()
assert abs(workspace.read().z - [1.0, 0.0]).max() < 1e-3
modules = [row.module for row in TABLE.values() if row.module]
print(*sorted(m for m in modules if sys.modules.get(m) is not None))
"""
    assert run_program(program).split() == loaded.split()
