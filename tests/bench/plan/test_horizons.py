"""Horizon sweeps: planned once per pair of horizons, refused in one line, recorded with sizes."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dpbench import (
    load_results,
    load_scenario,
    open_workspace,
    record_sequence,
    replay,
    run_campaign as run,
)
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.plan.suite import ReplayTable, SuiteFile, load_path_and_suite
from dpbench.bench.run.exact_loop import ExactLoop, rebuild_sequence, solve_loop_exactly
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.qp.referee.referee import certify
from dpbench.scenario.scenario import build_scenario_from_documents
from tests.bench.deterministic import suite_file, suite_toml


def _written(folder: Path, *horizons: str) -> Path:
    replay = {"scenario": "paper", "steps": 12, "horizons": horizons}
    calls = {"routes": ["native"], "policies": ["reuse"]}
    random = {"families": ["degenerate"], "sizes": [[5, 8]]}
    tables = {"replay": [replay | calls], "random": [random]}
    return suite_file(folder, suite_toml(rounds=1, warmup_steps=2, **tables))


def _suite(*horizons: str, scenario: str = "paper") -> SuiteFile:
    table = ReplayTable(scenario=scenario, steps=12, horizons=list(horizons))
    return SuiteFile(title="x", solvers=["daqp"], baseline_law=False, replay=[table])


def test_each_pair_of_horizons_is_a_problem_of_its_own() -> None:
    cells = [planned.cell for planned in plan_suite(_suite("30/5", "60/10", "40/10"))]
    assert [cell.sequence for cell in cells] == ["paper-30-5", "paper-60-10", "paper-40-10"]
    made = [build_scenario_from_documents(cell.scenario) for cell in cells]
    assert [(s.problem.N_p, s.problem.N_c) for s in made] == [(30, 5), (60, 10), (40, 10)]
    assert len({cell.problem_key for cell in cells}) == 3
    assert all(cell.steps == 12 for cell in cells)


def test_without_horizons_those_of_the_tuning_hold_under_the_plain_name() -> None:
    plain, swept = ReplayTable(scenario="paper"), ReplayTable(scenario="paper", horizons=["9/3"])
    suite = SuiteFile(title="x", solvers=["daqp"], baseline_law=False, replay=[plain, swept])
    cells = [planned.cell for planned in plan_suite(suite)]
    assert [cell.sequence for cell in cells] == ["paper", "paper-9-3"]
    assert cells[0].scenario == load_scenario("paper").files
    only = [planned.cell.sequence for planned in plan_suite(suite, scenarios=["paper"])]
    assert only == ["paper", "paper-9-3"]


@pytest.mark.parametrize(
    "text", ["30", "30/", "/5", "5/30", "30/0", "0/0", "30/5/2", "-30/5", "3 0/5"]
)
def test_bad_horizons(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = _written(tmp_path, "30/5", text)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    found = capsys.readouterr()
    (line,) = found.err.strip().splitlines()
    assert str(path) in line and "horizons" in line and repr(text) in line and "N_c" in line
    assert not (tmp_path / "out").exists()


def test_the_same_horizons_twice_and_too_long_ones_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="twice"):
        load_path_and_suite(_written(tmp_path, "30/5", "030/05"))
    with pytest.raises(InputError, match=r"paper with horizons 2000/5.*prediction_horizon"):
        plan_suite(_suite("2000/5"))


def test_names_of_sweeps_must_differ_from_those_of_scenarios(tmp_path: Path) -> None:
    theirs = tmp_path / "paper-60-10.toml"
    text = Path(__file__).parents[3] / "problems" / "scenarios" / "rough.toml"
    theirs.write_text(text.read_text(encoding="utf-8"), encoding="utf-8")
    tables = [*_suite("60/10").replay, ReplayTable(scenario=str(theirs), steps=12)]
    suite = SuiteFile(title="x", solvers=["daqp"], baseline_law=False, replay=tables)
    with pytest.raises(InputError, match=r"two scenarios called 'paper-60-10'"):
        plan_suite(suite)


@pytest.mark.slow
def test_the_rows_say_how_large_their_problems_are(tmp_path: Path) -> None:
    out = run(_written(tmp_path, "20/4", "6/2"), tmp_path / "out")
    runs = load_results(out).runs.set_index("sequence")
    for name, sizes in {"paper-20-4": (20, 4, 12, 12), "paper-6-2": (6, 2, 6, 6)}.items():
        assert tuple(runs.loc[name, ["N_p", "N_c", "n", "m"]]) == sizes
        assert runs.loc[name, "outcome"] == "finished"
        assert runs.loc[name, "error_move_max"] < 1e-9
    drawn = runs[~runs.index.str.startswith("paper")]
    assert drawn[["N_p", "N_c"]].isna().all(axis=None)
    assert (drawn["n"] == 5).all() and (drawn["m"] == 8).all()


def test_stacked_form_is_counted_as_the_solver_gets_it() -> None:
    sequence = record_sequence(load_scenario("paper").truncate(3))
    workspace = open_workspace("quadprog")
    row = replay(sequence, workspace, repeats=1, formulation="condensed_stacked").summary
    assert (row["n"], row["m"]) == (15, 60)
    assert pd.isna(row["N_p"]) and pd.isna(row["N_c"])


@pytest.mark.parametrize(
    ("name", "pair"), [("paper", (30, 5)), ("paper", (80, 20)), ("turn", (20, 4))]
)
def test_loops_keep_their_optima(tmp_path: Path, name: str, pair: tuple[int, int]) -> None:
    scenario = load_scenario(name).with_horizons(*pair).truncate(6)
    exact = solve_loop_exactly(scenario)
    exact.save(tmp_path / "exact.npz")
    kept = ExactLoop.load(tmp_path / "exact.npz").optima
    sequence = rebuild_sequence(scenario, exact)
    assert len(kept) == len(sequence) == 6
    for k, optimum in enumerate(kept):
        again = certify(sequence.base.at(sequence.step(k)))
        assert np.isfinite(optimum.bound) and np.isfinite(again.bound)
        assert np.abs(optimum.z - again.z).max() <= optimum.bound + again.bound
        np.testing.assert_array_equal(optimum.z, exact.z[k])


@pytest.mark.parametrize(
    ("horizons", "product", "cautions"),
    [
        ("30/5", {}, ["weather has N_p = 60; the replay uses 30"]),
        ("60/5", {}, []),
        ("30/5", {"controller.prediction_horizon": [30, 40]}, []),
        (
            "20/5",
            {"controller.prediction_horizon": [30, 40]},
            ["weather has N_p = 30 and 40; the replay uses 20"],
        ),
    ],
)
def test_a_replay_of_other_horizons_than_the_study_is_said(
    horizons: str,
    product: dict[str, list[int]],
    cautions: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The suite is run as it is; `run` and `check` print one line."""
    varied = product or {"controller.control_horizon": [3, 5]}
    study = {"base": "weather", "steps": 12, "product": varied}
    replay = {"scenario": "weather", "steps": 12, "horizons": [horizons]}
    path = suite_file(tmp_path, suite_toml(study=[study], replay=[replay]))
    remarks = RunRequest(str(path)).make_plan().remarks
    assert [line for line in remarks if "N_p" in line] == cautions
    assert main(["check", str(path)]) == 0
    printed = capsys.readouterr().out
    assert all(caution in printed for caution in cautions) and ("N_p" in printed) == bool(cautions)


def test_a_replay_of_other_horizons_than_a_closed_loop_is_said(tmp_path: Path) -> None:
    loop, replay = {"scenarios": ["paper"]}, {"scenario": "paper", "horizons": ["60/5", "90/5"]}
    path = suite_file(tmp_path, suite_toml(closed_loop=[loop], replay=[replay]))
    remarks = RunRequest(str(path)).make_plan().remarks
    assert "paper has N_p = 30; the replay uses 60 and 90" in remarks
