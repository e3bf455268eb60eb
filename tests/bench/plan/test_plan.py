"""A suite becomes cells: each once, under all the names it was asked for."""

from pathlib import Path

import pytest

from dpbench.bench.campaign import run_campaign
from dpbench.bench.plan.configurations import BASELINE_LAW, choose_solvers
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import (
    ClosedLoopTable,
    ReplayTable,
    ReportTable,
    SuiteFile,
    load_path_and_suite,
)
from dpbench.bench.record.cell import Cell
from dpbench.cli.check import check_file
from dpbench.errors import InputError, UnknownNameError
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.table import find_solver_record


def test_a_cell_asked_for_twice_keeps_all_names_of_its_settings() -> None:
    tables = [
        ReplayTable(scenario="paper", steps=20, settings=["default", "high"]),
        ReplayTable(scenario="paper", steps=20, routes=["native"]),
    ]
    suite = SuiteFile(title="x", solvers=["paper_active_set"], baseline_law=False, replay=tables)
    (planned,) = plan_suite(suite)
    assert planned.cell.settings == "default"
    assert planned.alias_settings == ("high",)


def test_the_standard_suite_runs_what_its_verdict_needs() -> None:
    _, suite = load_path_and_suite("standard")
    places: dict[str, dict[tuple[str, str, str], dict[tuple[str, str], int]]] = {}
    for planned in plan_suite(suite):
        cell = planned.cell
        if planned.refused or cell.units == "si" or cell.solver in {*CALIBRATION, BASELINE_LAW}:
            continue
        for settings in (cell.settings, *planned.alias_settings):
            place = (cell.mode, cell.sequence or cell.scenario_name)
            ways = places.setdefault(cell.solver, {})
            ways.setdefault((cell.route, cell.policy, settings), {})[place] = cell.steps
    for solver, ways in places.items():
        row = find_solver_record(solver)
        usual = ways[row.default_route, "fresh", "default"]
        assert ways[row.default_route, "fresh", "high"] == usual, solver
        kept = {
            policy
            for policy in ("reuse", "warm")
            if policy in row.policies_by_route.get("native", ())
        }
        for settings in ("default", "high"):
            whole = [p for p in kept if ways["native", p, settings] == usual]
            assert bool(whole) == bool(kept), (solver, settings)


def test_a_table_of_loops_may_ask_only_some_solvers_of_its_suite() -> None:
    tables = [
        ClosedLoopTable(scenarios=["calm"], steps=5, solvers=["daqp"]),
        ClosedLoopTable(scenarios=["rough"], steps=5, without=["daqp"]),
    ]
    suite = SuiteFile(title="x", solvers=["daqp", "osqp"], baseline_law=False, closed_loop=tables)
    cells = [(p.cell.scenario_name, p.cell.solver) for p in plan_suite(suite)]
    assert cells == [("calm", "daqp"), ("rough", "osqp")]
    wrong = SuiteFile(title="x", solvers=["osqp"], baseline_law=False, closed_loop=tables)
    with pytest.raises(InputError, match=r"closed_loop\.solvers"):
        plan_suite(wrong)


def test_a_fallback_is_one_of_the_policies_by_name() -> None:
    with pytest.raises(ValueError, match=r"'shifted_plan', 'hold', 'clip'"):
        ClosedLoopTable(scenarios=["calm"], fallback="shifted")


def test_vessels_multiply_the_scenarios_and_fallbacks_tell_rows_apart() -> None:
    table = ClosedLoopTable(
        scenarios=["calm", "rough"], vessels=["osv", "cybership2"], fallback="hold", steps=5
    )
    suite = SuiteFile(title="x", solvers=["daqp"], baseline_law=False, closed_loop=[table])
    cells = [planned.cell for planned in plan_suite(suite)]
    assert [cell.scenario_name for cell in cells] == [
        "calm@osv (hold)",
        "calm@cybership2 (hold)",
        "rough@osv (hold)",
        "rough@cybership2 (hold)",
    ]
    assert [cell.scenario["vessel_name"] for cell in cells] == ["osv", "cybership2"] * 2


def test_the_harness_own_configurations_run_once_per_timed_sequence_and_never_steer() -> None:
    ways = {"settings": ["default", "high"], "units": ["scaled", "si"]}
    policies = {"policies": ["fresh", "warm"]}
    document = {
        "title": "x",
        "solvers": ["daqp"],
        "baseline_law": False,
        "closed_loop": [{"scenarios": ["paper"], "steps": 5, **ways}],
        "replay": [
            {"scenario": "paper", "steps": 5, **ways, **policies},
            {"scenario": "paper", "steps": 5, "routes": ["native"], "policies": ["reuse"]},
        ],
        "random": [{"families": ["plain"], "sizes": [[4, 4]], "steps": 2}],
    }

    def own(*only: str, **more: object) -> list[Cell]:
        suite = SuiteFile.model_validate(document | more)
        cells = [planned.cell for planned in plan_suite(suite, solvers=only or None)]
        return [cell for cell in cells if cell.solver in CALIBRATION]

    assert own() == [] and own(solvers=["all"]) == []
    configurations = own(calibration=True)
    assert sorted(cell.solver for cell in configurations) == sorted(CALIBRATION)
    assert {(cell.mode, cell.route, cell.policy, cell.units) for cell in configurations} == {
        ("replay", "native", "reuse", "scaled")
    }
    assert [cell.solver for cell in own("no_op")] == ["no_op"]
    # A millisecond of waiting, five steps, five rounds and a warm-up, each run twice.
    limits = {cell.solver: cell.limit_s for cell in configurations}
    assert limits["busy_wait_1000us"] - limits["no_op"] == pytest.approx(0.06)


def test_a_replay_may_ask_only_some_solvers_of_its_suite() -> None:
    def solvers_of(*names: str) -> list[str]:
        table = ReplayTable(scenario="paper", steps=5, solvers=list(names))
        suite = SuiteFile(title="x", solvers=["daqp", "osqp"], baseline_law=False, replay=[table])
        return [planned.cell.solver for planned in plan_suite(suite)]

    assert solvers_of() == ["daqp", "osqp"]
    assert solvers_of("osqp", "piqp") == ["osqp"]
    with pytest.raises(InputError, match=r"replay\.solvers: found piqp; allowed: .*daqp, osqp"):
        solvers_of("piqp")
    with pytest.raises(UnknownNameError, match=r"suite: replay\.solvers: found 'nobody'"):
        solvers_of("nobody")


def test_a_complaint_about_a_suite_names_its_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    replay = '[[replay]]\nscenario = "paper"\nsolvers = ["piqp"]\n'
    path.write_text(f'title = "x"\nsolvers = ["daqp"]\n{replay}', encoding="utf-8")
    for complain in (lambda: check_file(str(path)), lambda: run_campaign(path, tmp_path / "out")):
        with pytest.raises(InputError, match=r"mine\.toml: replay\.solvers: found piqp"):
            complain()
    assert not (tmp_path / "out").exists()


def test_a_baseline_that_the_suite_does_not_run_is_refused() -> None:
    suite = SuiteFile(title="t", solvers=["daqp", "osqp"], report=ReportTable(baseline="scs"))
    with pytest.raises(InputError, match=r"report.baseline: found 'scs'; allowed: .*daqp, osqp"):
        choose_solvers(suite, None)
    assert choose_solvers(suite.model_copy(update={"report": ReportTable()}), ["osqp"]) == ["osqp"]


def test_superseded_solvers_run_where_a_suite_wants_them_or_names_them() -> None:
    """Suite `standard` leaves them out, `full` does not; what one names runs."""
    superseded = {"elastiqp_pdal", "kvxopt"}
    for name, expected in (("standard", set()), ("full", superseded)):
        _, suite = load_path_and_suite(name)
        assert superseded & set(choose_solvers(suite, None)) == expected
    named = SuiteFile(title="x", solvers=["kvxopt", "daqp"], superseded=False, baseline_law=False)
    assert choose_solvers(named, None) == ["kvxopt", "daqp"]
    assert choose_solvers(load_path_and_suite("standard")[1], ["kvxopt"]) == ["kvxopt"]
