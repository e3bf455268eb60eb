"""The tolerance levels and the validation of a solver's own keys."""

import re
from contextlib import nullcontext
from importlib import import_module

import numpy as np
import pytest
from scipy.sparse import csc_matrix

from dpbench.cli.main import main
from dpbench.errors import SettingsError
from dpbench.notebook.names import list_solvers
from dpbench.qp.program import QPStep
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Status
from dpbench.solvers.contract import LEVELS, TOLERANCES
from dpbench.solvers.libraries import NATIVE, THROUGH_QPSOLVERS
from dpbench.solvers.libraries.osqp import make_default_settings_of_library
from dpbench.solvers.open import open_workspace
from dpbench.solvers.settings import (
    describe_option_presets,
    find_options_of_preset,
    format_library_call,
    has_distinct_tolerance_presets,
    list_preset_names,
    resolve_settings_to_options,
)
from dpbench.solvers.table import TABLE, find_solver_availability
from tests.solvers.conftest import solve_qp

# Names that the libraries keep no list of, with a value each may take.
TIGHT = 1e-8
CONE = {"abstol": TIGHT, "feastol": TIGHT, "kktreg": 1e-9, "maxiters": 50}
CONE |= {"refinement": 1, "reltol": TIGHT, "use_correction": True}
ECOS = {"abstol": TIGHT, "abstol_inacc": 1e-5, "feastol": TIGHT, "feastol_inacc": 1e-5}
ECOS |= {"max_iters": 50, "nitref": 5, "reltol": TIGHT, "reltol_inacc": 1e-5}
SCS = {"acceleration_interval": 5, "acceleration_lookback": 5, "adaptive_scale": False}
SCS |= {"alpha": 1.4, "eps_abs": 1e-6, "eps_infeas": 1e-6, "eps_rel": 1e-6, "max_iters": 5000}
SCS |= {"normalize": False, "rho_x": 1e-5, "scale": 0.2, "time_limit_secs": 5.0}
WRITTEN_DOWN = {"cvxopt": CONE, "kvxopt": CONE, "ecos": ECOS, "scs": SCS}
# Exact answers that the library does not claim, see its record.
UNREACHED = {("qpax", "high"): Status.MAX_ITERATIONS}


def solve(solver, settings, qp):
    workspace = open_workspace(solver, settings=settings)
    return solve_qp(workspace, qp)


@pytest.mark.parametrize("name", LEVELS)
def test_every_level_is_accepted_by_the_library(installed, name, sequence):
    options = find_options_of_preset(name, installed)
    for adapters in (THROUGH_QPSOLVERS, NATIVE):
        if installed in adapters:
            assert resolve_settings_to_options(dict(options), adapters[installed]) == options
    expected = UNREACHED.get((installed, name), Status.SOLVED)
    assert solve(installed, name, sequence.base).status is expected


def test_high_is_more_accurate_than_default(installed, sequence):
    exact = certify(sequence.base).z
    default, high = (
        np.abs(solve(installed, name, sequence.base).z - exact).max()
        for name in ("default", "high")
    )
    # DAQP visits the same active sets at both and is exact at both: rounding may differ.
    assert high <= default if has_distinct_tolerance_presets(installed) else high == default


def test_settings_matter_where_there_are_levels():
    without = {name for name in TABLE if not has_distinct_tolerance_presets(name)}
    own = {"paper_active_set", "unconstrained_clipped"}
    assert without >= {*own, "pyqpmad", "qpoases", "quadprog"}
    assert not without & {"daqp", "hildreth", "osqp", "piqp_sparse"}


@pytest.mark.parametrize("solver", TABLE)
def test_a_stated_tolerance_lies_among_the_levels(solver):
    for level, tolerance in TOLERANCES.items():
        assert find_options_of_preset(f"{tolerance:g}", solver) == find_options_of_preset(
            level, solver
        )
    between = find_options_of_preset("2e-5", solver)
    if has_distinct_tolerance_presets(solver):
        assert 2e-5 in between.values()
        assert between not in [find_options_of_preset(level, solver) for level in LEVELS]
    else:
        assert between == find_options_of_preset("default", solver)


@pytest.mark.parametrize("name", ["1e-4.", "-1e-4", "0", "nan", "inf", "1", "1e-4x", ""])
def test_what_is_no_tolerance_is_no_name_of_settings(name):
    with pytest.raises(SettingsError, match="a tolerance such as 1e-4"):
        find_options_of_preset(name, "osqp")


def error(solver, route, settings, qp):
    workspace = open_workspace(solver, route=route, settings=settings)
    return np.abs(solve_qp(workspace, qp).z - certify(qp).z).max()


@pytest.mark.parametrize("route", ["qpsolvers", "native"])
def test_a_tolerance_decides_how_exact_an_answer_is(route, sequence):
    loose, tight = (error("clarabel", route, name, sequence.base) for name in ("1e-2", "1e-11"))
    assert tight < 1e-2 * loose


@pytest.mark.parametrize("route", ["qpsolvers", "native"])
@pytest.mark.parametrize("name", sorted(set(list_preset_names("osqp")) - set(LEVELS)))
def test_polishing_is_a_setting_of_its_own(route, name, sequence):
    # A polished answer solves the KKT system of its active set to rounding, here some 1e-15.
    assert error("osqp", route, name, sequence.base) <= 1e-13
    assert error("osqp", route, "default", sequence.base) > 1e-6


def test_the_levels_are_described_in_words(installed):
    lines = describe_option_presets(installed).splitlines()
    assert [line.split(":")[0] for line in lines] == list(list_preset_names(installed))
    if has_distinct_tolerance_presets(installed):
        assert "1e-09" in lines[3]
    else:
        assert "no tolerance to set" in lines[3]


def _name_arguments_of_osqp(qp):
    """Return the names that the code of a library call uses, with the bounds as rows of A."""
    return {
        "P": csc_matrix(qp.P),
        "q": qp.q,
        "A": csc_matrix(np.vstack([qp.A, np.eye(qp.n)])),
        "l": np.append(qp.l, qp.lb),
        "u": np.append(qp.u, qp.ub),
    }


@pytest.mark.parametrize("policy", ["fresh", "reuse", "warm"])
@pytest.mark.parametrize("settings", ["default", "high_polished", {"rho": 1.6, "eps_abs": 1e-5}])
def test_the_call_of_the_library_gives_the_answer_of_the_workspace(policy, settings, sequence):
    """The same iterations and the same bits, by code without dpbench, and the same settings."""
    qp = sequence.base
    workspace = open_workspace("osqp", route="native", policy=policy, settings=settings)
    if policy == "fresh":
        answer = solve_qp(workspace, qp)
    else:
        workspace.setup(qp.for_setup())
        workspace.update(QPStep(qp.q, qp.l, qp.u))
        workspace.solve()
        answer = workspace.read()
    names = _name_arguments_of_osqp(qp)
    code = format_library_call("osqp", "native", policy, settings)
    exec(compile(code, "call", "exec"), names)
    if policy != "fresh":
        names["m"].update(q=qp.q)
    result = names["m"].solve(raise_error=False)
    assert result.info.iter == answer.iterations
    assert result.x.tolist() == answer.z.tolist()
    assert ("# New P or A: also update(Px=" in code) is (policy != "fresh")
    assert "scaled QP" in code and "adaptive_rho_interval=50" in code
    assert "# P and A: sparse matrices" in code
    assert ("q, l and u: contiguous arrays" in code) is (policy != "fresh")


def test_osqp_reads_wrong_numbers_of_an_array_that_is_not_contiguous(sequence):
    """As the comment of the code states: why it asks for contiguous arrays."""
    qp = sequence.base
    names = _name_arguments_of_osqp(qp)
    exec(compile(format_library_call("osqp", "native", "warm", "high"), "call", "exec"), names)
    rows = np.asfortranarray([qp.q, np.zeros(qp.n)])
    answers = []
    for q in (np.ascontiguousarray(rows[0]), rows[0]):
        names["m"].update(q=q)
        answers.append(names["m"].solve(raise_error=False).x)
    assert not np.allclose(*answers, atol=1e-3)


def test_zeros_at_the_end_of_a_shift_reproduce_a_warm_step(sequence):
    """As the comment of the code states: x, y of A and of the bounds end with a block of zeros."""
    qp, step = sequence.base, sequence.steps[1]
    workspace = open_workspace("osqp", route="native", policy="warm", settings="high")
    workspace.setup(qp.for_setup())
    for vectors in (QPStep(qp.q, qp.l, qp.u), step):
        workspace.update(vectors)
        workspace.solve()
    names = _name_arguments_of_osqp(qp)
    code = format_library_call("osqp", "native", "warm", "high")
    exec(compile(code, "call", "exec"), names)
    names["m"].update(q=qp.q)
    first = names["m"].solve(raise_error=False)
    by_block = [first.x, first.y[: qp.m], first.y[qp.m :]]
    blocks = qp.block, qp.m * qp.block // qp.n, qp.block
    x, rows, bounds = (np.append(v[b:], np.zeros(b)) for v, b in zip(by_block, blocks, strict=True))
    names["m"].update(q=step.q, l=np.append(step.l, qp.lb), u=np.append(step.u, qp.ub))
    names["m"].warm_start(x=x, y=np.append(rows, bounds))
    second = names["m"].solve(raise_error=False)
    answer = workspace.read()
    assert second.info.iter == answer.iterations
    assert second.x.tolist() == answer.z.tolist()


def test_there_is_no_call_of_a_library_that_no_adapter_writes():
    assert format_library_call("daqp", "native", "warm", "default") == ""
    assert format_library_call("osqp", "qpsolvers", "warm", "default") == ""


def test_the_nearest_options_are_named_beside_an_unknown_one():
    with pytest.raises(SettingsError) as caught:
        open_workspace("osqp", settings={"rhoo": 1.0})
    assert caught.value.allowed.startswith("rho, rho_is_vec, adaptive_rho, … ")


def test_osqp_adapts_its_penalty_by_iterations_at_every_level():
    for name in list_preset_names("osqp"):
        assert "adaptive_rho_interval=50" in describe_option_presets("osqp").splitlines()[0]
        assert (
            resolve_settings_to_options(name, THROUGH_QPSOLVERS["osqp"])["adaptive_rho_interval"]
            == 50
        )
    assert (
        resolve_settings_to_options({"eps_abs": 1e-5}, NATIVE["osqp"])["adaptive_rho_interval"]
        == 50
    )


@pytest.mark.parametrize("key", ["eps_absolut", "verbose", "initvals", "backend"])
def test_an_unknown_key_is_refused(installed, key):
    with pytest.raises(SettingsError, match=f"settings of {installed}: {key}"):
        open_workspace(installed, settings={key: 1e-6})


@pytest.mark.parametrize(
    ("solver", "key", "near"),
    [("osqp", "eps_abss", "eps_abs"), ("sip", "termination.max_gap", "termination.max_")],
)
def test_the_refusal_names_the_nearest_keys(solver, key, near):
    group, _, name = key.rpartition(".")
    settings = {group: {name: 1.0}} if group else {name: 1.0}
    words = f"{key}: found an unknown option; allowed: .*{near}.*"
    words += re.escape(f'`list_solvers().options("{solver}")`')
    with pytest.raises(SettingsError, match=words):
        open_workspace(solver, settings=settings)
    assert all(near in " ".join(options) for options in list_solvers().options(solver).values())


@pytest.mark.parametrize("route", ["native", "qpsolvers"])
@pytest.mark.parametrize(
    ("key", "why"), [("verbose", "dpbench sets.* without output"), ("warm_starting", "the policy")]
)
def test_an_option_that_dpbench_sets_is_refused(route, key, why):
    with pytest.raises(SettingsError, match=f"{key}: found an option that {why}.*: other options"):
        open_workspace("osqp", route=route, settings={key: False})


@pytest.mark.parametrize("solver", ["clarabel", "highs", "osqp", "piqp", "pyqpmad", "qpalm"])
def test_a_value_of_the_wrong_kind_is_refused(solver):
    key = {"highs": "time_limit", "pyqpmad": "tolerance"}.get(solver, "max_iter")
    with pytest.raises(SettingsError, match=f"{key}: found 'many'"):
        open_workspace(solver, settings={key: "many"})


@pytest.mark.parametrize("route", ["native", "qpsolvers"])
@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [("primal_tol", "1e-7", "a number"), ("iter_limit", -3, "0 or more")],
)
def test_a_value_that_fails_each_solve_is_refused_at_opening(route, key, value, allowed):
    """By its defaults where the library has no settings object."""
    with pytest.raises(SettingsError, match=f"daqp: {key}: found .*{value!r}; allowed: {allowed}"):
        open_workspace("daqp", route=route, settings={key: value})


@pytest.mark.parametrize("key", TABLE["osqp"].ranges)
def test_the_ranges_of_osqp_are_those_of_the_library(key, sequence):
    """It refuses all values outside in its set-up, as error 2, and takes those inside."""
    library = import_module("osqp.ext_builtin")
    allowed = TABLE["osqp"].ranges[key]
    kind = type(getattr(make_default_settings_of_library(), key))
    tried = {kind(x) for x in (-1.0, 0.0, 1e-9, 0.5, 0.999, 1.0, 1.999, 2.0, 3.0, 1e3)}
    assert 0 < sum(map(allowed.contains, tried)) < len(tried)
    low, high = np.zeros(1), np.ones(1)
    for value in sorted(tried):
        settings = make_default_settings_of_library()
        settings.verbose = False
        setattr(settings, key, value)
        one = library.CSC(csc_matrix([[1.0]]))
        known = nullcontext() if allowed.contains(value) else pytest.raises(ValueError, match="2")
        with known:
            library.OSQPSolver(one, low, one, low, high, 1, 1, settings)


@pytest.mark.parametrize("route", ["native", "qpsolvers"])
@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("rho", -1, "above 0"),
        ("eps_abs", -1e-6, "0 or more"),
        ("alpha", 2.0, "above 0 and below 2.*"),
    ],
)
def test_a_value_out_of_range_is_refused_at_opening(route, key, value, allowed):
    with pytest.raises(SettingsError, match=f"osqp: {key}: found {value}; allowed: {allowed}"):
        open_workspace("osqp", route=route, settings={key: value})


@pytest.mark.parametrize("route", ["native", "qpsolvers"])
@pytest.mark.parametrize(
    ("solver", "key", "allowed"),
    [
        ("osqp", "rho", "a number"),
        ("osqp", "eps_abs", "a number"),
        ("osqp", "scaling", "a whole number"),
        ("daqp", "primal_tol", "a number"),
    ],
)
def test_a_boolean_is_no_number(route, solver, key, allowed):
    with pytest.raises(SettingsError, match=f"{key}: found True; allowed: {allowed}$"):
        open_workspace(solver, route=route, settings={key: True})


def test_a_switch_takes_a_boolean():
    """Also one that is an integer in C."""
    for key in ("adaptive_rho", "polishing", "scaled_termination"):
        assert open_workspace("osqp", settings={key: True})


@pytest.mark.parametrize("route", ["native", "qpsolvers"])
def test_osqp_needs_a_tolerance_above_zero(route):
    open_workspace("osqp", route=route, settings={"eps_abs": 1e-6, "eps_rel": 0})
    allowed = "eps_abs, eps_rel: found 0; allowed: at least one of them above 0"
    with pytest.raises(SettingsError, match=allowed):
        open_workspace("osqp", route=route, settings={"eps_abs": 0, "eps_rel": 0.0})


def test_a_tolerance_is_no_text_where_the_library_has_no_defaults():
    """By the presets of the solver's record."""
    with pytest.raises(SettingsError, match="feastol: found the text '1e-7'; allowed: a number"):
        open_workspace("cvxopt", settings={"feastol": "1e-7"})


def test_an_unknown_name_is_refused(installed):
    with pytest.raises(SettingsError, match=r"'hihg'; allowed: default, low, mid, high"):
        open_workspace(installed, settings="hihg")


@pytest.mark.parametrize("solver", WRITTEN_DOWN)
def test_names_written_down_are_the_librarys(solver, sequence):
    values = WRITTEN_DOWN[solver]
    assert sorted(values) == sorted(THROUGH_QPSOLVERS[solver].list_options())
    for key, value in values.items():
        answer = solve(solver, {key: value}, sequence.base)
        assert answer.status is Status.SOLVED, f"{key}: {answer.detail}"


@pytest.mark.parametrize(
    ("solver", "loose"),
    [
        ("sip", {"termination": {"max_absolute_residual": 1e-2}}),
        ("osqp", {"check_termination": 1}),
    ],
)
def test_a_setting_reaches_the_library(solver, loose, sequence):
    counts = [solve(solver, settings, sequence.base).iterations for settings in (loose, "default")]
    assert counts[0] < counts[1]


@pytest.mark.parametrize(
    ("value", "allowed"),
    [(2**40, " that the library accepts"), (-1, " that the library accepts"), (1.5, ""), ("a", "")],
)
def test_a_number_that_does_not_fit_is_refused(value, allowed):
    """Clarabel's limit of iterations is an unsigned integer of 32 bits."""
    message = f"settings of clarabel: max_iter: found .*: a whole number{allowed}$"
    with pytest.raises(SettingsError, match=message):
        resolve_settings_to_options({"max_iter": value}, NATIVE["clarabel"])


def test_presets_of_qpoases_are_settings_that_change_its_steps(sequence):
    """The name of a preset says which options of qpOASES it sets; both reach the optimum."""
    if not find_solver_availability("qpoases").ok:
        pytest.skip("casadi is not installed")
    exact = certify(sequence.base).z
    for name, atol in (("reliable", 1e-9), ("mpc", 1e-6)):
        assert set(find_options_of_preset(name, "qpoases")) <= set(NATIVE["qpoases"].list_options())
        answer = solve("qpoases", name, sequence.base)
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, exact, rtol=0, atol=atol)
    assert not has_distinct_tolerance_presets("qpoases")


def test_the_options_of_a_solver_are_listed(capsys):
    assert main(["list", "solvers", "osqp"]) == 0
    options = capsys.readouterr().out.partition("options, native:")[2]
    # https://osqp.org/docs/interfaces/solver_settings.html
    assert {"rho,", "eps_abs,", "max_iter,", "check_termination,"} <= set(options.split())
    assert main(["list", "suites", "osqp"]) == 2
    assert "found 'osqp'; allowed: a NAME only where KIND is solvers" in capsys.readouterr().err
