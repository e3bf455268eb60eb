"""Formulations as an axis: the same problems, the same assessment, refused where there are none."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench import (
    load_results,
    load_scenario,
    open_workspace,
    record_sequence,
    replay,
    run_closed_loop,
    write_report,
)
from dpbench.bench.plan import suite
from dpbench.bench.plan.cells import NO_MODEL, SEMIDEFINITE_REFUSAL
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.run.formulation import QPBuilder, formulate_sequence
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Solution
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents
from dpbench.solvers.contract import Policy, Workspace
from dpbench.solvers.table import find_solver_availability
from tests.bench.deterministic import run_suite, suite_toml

SOLVER = "piqp_multistage"
HIGH = dict.fromkeys(("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"), 1e-12)


def workspace(policy: Policy = "reuse") -> Workspace:
    return open_workspace(SOLVER, route="native", policy=policy, settings=HIGH)


def early_loss() -> Scenario:
    """`thruster_loss` with its fault after 6 s, at step 20, in the middle of a short run."""
    files = deepcopy(load_scenario("thruster_loss").files)
    (fault,) = files["scenario"]["faults"]
    fault["at_s"] = 6.0
    return build_scenario_from_documents(files)


# Steps of the last with a limit that hardly acts leave an interior point 3e-7 from the optimum.
LOOPS = {
    "paper": lambda: load_scenario("paper").truncate(60),
    "limits fall": lambda: early_loss().truncate(60),
    "preview": lambda: load_scenario("move_filtered").truncate(25),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_sparse_closed_loop_is_judged_true(name: str) -> None:
    scenario = LOOPS[name]()
    run = run_closed_loop(scenario, workspace(), formulation="sparse")
    stages = scenario.problem.N_c * 15 + (scenario.problem.N_p - scenario.problem.N_c) * 9
    assert run.summary["n"] == stages
    assert run.summary["formulation"] == "sparse"
    assert run.steps["true_1e6"].all() and run.steps["claimed"].all()
    assert run.steps["error_plan"].max() <= 1e-7
    assert run.summary["dev_position_max_m"] < 1e-6
    assert (run.steps["emit_ns"] > 0).all()


@pytest.mark.parametrize("policy", ["fresh", "reuse"])
def test_a_sparse_replay_is_judged_true(policy: Policy) -> None:
    sequence = record_sequence(load_scenario("paper").truncate(25))
    run = replay(sequence, workspace(policy), repeats=2, formulation="sparse")
    assert run.steps["true_1e6"].all() and len(run.steps) == 3 * 25
    assert run.steps["error_plan"].max() <= 1e-7
    assert run.summary["formulation"] == "sparse"


def test_the_twin_in_newtons_is_the_scaled_one_in_other_units() -> None:
    scenario = load_scenario("paper").truncate(4)
    scaled, own = (
        record_sequence(scenario, units=units).sparse_equivalent for units in ("scaled", "si")
    )
    assert scaled is not None and own is not None
    du, one = scenario.problem.du_max, np.ones(9)
    moved, rest = (scenario.problem.N_c, np.ones((scenario.problem.N_p - scenario.problem.N_c) * 9))
    z = np.concatenate([np.tile(np.concatenate([du, du, one]), moved), rest])
    row = np.concatenate([np.tile(np.concatenate([du, one, du]), moved), rest])
    for k in range(4):
        a, b = scaled().sequence.problem(k), own().sequence.problem(k)
        pairs = {
            "P": (a.P, b.P * np.outer(z, z)),
            "q": (a.q, b.q * z),
            "A": (a.A, b.A * z / row[:, np.newaxis]),
            "l": (a.l, b.l / row),
            "u": (a.u, b.u / row),
            "lb": (a.lb, b.lb / z),
            "ub": (a.ub, b.ub / z),
        }
        for name, (expected, found) in pairs.items():
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12, err_msg=name)


def test_the_steps_of_a_sparse_replay_are_those_of_its_closed_loop() -> None:
    scenario = early_loss().with_horizons(6, 3).truncate(24)
    assert scenario.controller.changes[0][0] == 20
    exact, sequence = solve_loop_exactly(scenario), record_sequence(scenario)
    assert sequence.sparse_equivalent is not None
    sparse_equivalent, builder = sequence.sparse_equivalent(), QPBuilder(scenario, sparse=True)
    for k in range(len(sequence)):
        emitted, step = builder.rebuild(k, exact.theta[k]), sparse_equivalent.sequence.step(k)
        for name in ("q", "l", "u"):
            np.testing.assert_array_equal(getattr(emitted, name), getattr(step, name))
        found = certify(sparse_equivalent.sequence.problem(k))
        from_states = sparse_equivalent.condensed(Solution(0, found.z, found.y, found.y_box))
        expected = certify(sequence.problem(k))
        np.testing.assert_allclose(from_states.z, expected.z, rtol=0, atol=1e-8)


def test_formulations_are_an_axis_of_the_tables() -> None:
    three = ["condensed_box", "condensed_stacked", "sparse"]
    table = suite.ReplayTable(scenario="paper", steps=10, formulations=three)
    loops = suite.ClosedLoopTable(scenarios=["paper"], steps=10, formulations=three)
    cells = [p.cell for p in plan_suite(_suite(replay=[table], closed_loop=[loops]))]
    assert [(c.mode, c.formulation) for c in cells] == [
        *(("closed_loop", name) for name in three),
        *(("replay", name) for name in three),
    ]
    assert len({cell.problem_key for cell in cells}) == 2
    usual = plan_suite(_suite(replay=[suite.ReplayTable(scenario="paper", steps=10)]))
    assert [p.cell.formulation for p in usual] == ["condensed_box"]


def _suite(solvers: tuple[str, ...] = ("daqp",), **tables: object) -> suite.SuiteFile:
    return suite.SuiteFile(title="x", solvers=list(solvers), baseline_law=False, **tables)


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        ("paper", ""),
        ("thruster_loss", ""),
        ("thruster_loss_hard", ""),
        ("thruster_loss_soft", "soft limits"),
        ("watch_circle", "soft limits"),
        ("turn", "linearised again"),
    ],
)
def test_a_scenario_without_stages_is_a_refused_row(scenario: str, why: str) -> None:
    table = suite.ReplayTable(scenario=scenario, steps=5, formulations=["condensed_box", "sparse"])
    box, sparse = plan_suite(_suite(replay=[table]))
    assert box.refused == ""
    assert why in sparse.refused and bool(why) == bool(sparse.refused)
    assert load_scenario(scenario).controller.reason_for_no_sparse_form == sparse.refused
    if why:
        with pytest.raises(InputError, match=why):
            QPBuilder(load_scenario(scenario), sparse=True)


def test_a_solver_that_needs_a_definite_cost_is_refused_the_states() -> None:
    table = suite.ReplayTable(
        scenario="paper", steps=5, formulations=["condensed_stacked", "sparse"]
    )
    refused = {
        (p.cell.solver, p.cell.formulation): p.refused
        for p in plan_suite(_suite(("quadprog", "daqp"), replay=[table]))
    }
    assert refused == {
        ("quadprog", "condensed_stacked"): "",
        ("daqp", "condensed_stacked"): "",
        ("quadprog", "sparse"): SEMIDEFINITE_REFUSAL,
        ("daqp", "sparse"): "",
    }


def test_a_recorded_sequence_has_no_states_to_keep(tmp_path: Path) -> None:
    assert main(["export", "paper", "--steps", "3", "--out", str(tmp_path / "short.npz")]) == 0
    table = suite.RecordedTable(sequence="short.npz", formulations=["condensed_box", "sparse"])
    planned = plan_suite(_suite(recorded=[table]), beside=tmp_path)
    assert [p.refused for p in planned] == ["", NO_MODEL]
    one = np.ones(1)
    base = QuadraticProgram(np.eye(1), one, np.eye(1), -one, one, -one, one)
    vectors = np.ones((2, 1))
    sequence = QPSequence("bare", base, vectors, -vectors, vectors)
    with pytest.raises(InputError, match=r"sequence bare.*'sparse'"):
        replay(sequence, workspace(), repeats=1, formulation="sparse")


def test_the_old_key_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A suite with `formulation`, or with a formulation nobody knows, is said in one line."""
    head = 'title = "x"\n[[replay]]\nscenario = "paper"\n'
    for line, words in (
        ('formulation = "sparse"', ["formulation", "formulations"]),
        ('formulations = ["banded"]', ["formulations", "banded", "sparse"]),
    ):
        path = tmp_path / "bad.toml"
        path.write_text(head + line, encoding="utf-8")
        assert main(["check", str(path)]) == 2
        said = capsys.readouterr().err.strip()
        assert "\n" not in said and all(word in said for word in words), said


@pytest.mark.slow
def test_a_campaign_shows_formulations_side_by_side(tmp_path: Path) -> None:
    calls = {"formulations": ["condensed_box", "condensed_stacked", "sparse"], "steps": 20}
    text = suite_toml(
        **{"solvers": ["clarabel", "quadprog"], "rounds": 2, "warmup_steps": 5},
        replay=[{"scenario": "paper", "routes": ["qpsolvers", "native"], **calls}],
        closed_loop=[
            {"scenarios": ["paper"], "steps": 20, "formulations": ["condensed_box", "sparse"]}
        ],
    )
    out = run_suite(tmp_path, text)
    runs = load_results(out).runs
    clarabel = runs[runs["solver"] == "clarabel"]
    assert (clarabel["outcome"] == "finished").all() and len(clarabel) == 8
    assert (clarabel["true_share"] == 1.0).all() and (clarabel["error_plan_max"] < 1e-2).all()
    strict = runs[(runs["solver"] == "quadprog") & (runs["formulation"] == "sparse")]
    assert set(strict["outcome_detail"]) == {SEMIDEFINITE_REFUSAL}
    page = write_report(out).with_suffix(".md").read_text(encoding="utf-8")
    assert "The fastest formulation with accurate solutions, in 4 pairs of " in page
    assert (out / "tables" / "formulations.csv").is_file()


def test_the_suite_of_formulations_plans_all_three_and_none_twice() -> None:
    _, shipped = suite.load_path_and_suite("formulations")
    cells = [planned.cell for planned in plan_suite(shipped)]
    assert {cell.formulation for cell in cells} == {"condensed_box", "condensed_stacked", "sparse"}
    assert len({cell.to_json() for cell in cells}) == len(cells)


BAR = 1e-7
"""error_plan: the largest error of any move of the plan, in maximum increments."""

PIQP = {
    **dict.fromkeys(("eps_abs", "eps_duality_gap_abs"), 1e-12),
    **dict.fromkeys(("eps_rel", "eps_duality_gap_rel"), 0.0),
    "max_iter": 1000,
    "tau": 0.9,
}
HPIPM = {
    "mode": "BALANCE",
    **dict.fromkeys(("tol_stat", "tol_eq"), 1e-10),
    "tol_ineq": 1e-12,
    # Where a limit is weakly active the error is the root of what is left of λ·slack.
    "tol_comp": 1e-14,
    "iter_max": 200,
}
SETTINGS: dict[str, Any] = {"piqp_multistage": PIQP, "hpipm_ocp": HPIPM, "hpipm": HPIPM}
# HPIPM's dense solver factorises all n = 300 variables at once.
STEPS = {"hpipm": 5}


@pytest.mark.parametrize("solver", [name for name in SETTINGS if find_solver_availability(name).ok])
@pytest.mark.parametrize(
    ("scenario", "horizons", "steps"),
    [("paper", (30, 5), 40), ("paper_tight", (30, 5), 40), ("rough", (60, 10), 15)],
)
def test_exact_solvers(solver: str, scenario: str, horizons: tuple[int, int], steps: int) -> None:
    case = load_scenario(scenario).with_horizons(*horizons).truncate(STEPS.get(solver, steps))
    condensed = record_sequence(case)
    sequence, form = formulate_sequence("sparse", condensed)
    workspace = open_workspace(solver, route="native", policy="reuse", settings=SETTINGS[solver])
    workspace.setup(sequence.base)
    for k in range(len(sequence)):
        workspace.update(sequence.step(k))
        workspace.solve()
        found = workspace.read()
        assert found.claimed
        optimum = certify(condensed.problem(k))
        assert optimum.bound < BAR
        assert np.abs(form.solution(found).z - optimum.z).max() <= BAR
