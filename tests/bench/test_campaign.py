"""A campaign writes the tables the outside relies on and keeps what is finished."""

import json
from pathlib import Path

import numpy as np
import osqp
import pandas as pd
import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import AXIS_FORCES, RUN_COLUMNS, STEP_COLUMNS
from dpbench.errors import InputError, ResultsError, UnknownNameError
from dpbench.scenario.problem_files import find_problem_path
from tests.bench.deterministic import run_suite, suite_toml

pytestmark = pytest.mark.slow

SUITE = suite_toml(
    **{"solvers": ["quadprog", "osqp"], "baseline_law": True, "rounds": 2, "warmup_steps": 5},
    closed_loop=[
        {"scenarios": ["paper"], "steps": 30},
        {"scenarios": ["paper"], "units": ["si"], "settings": ["default", "high"], "steps": 20},
    ],
    replay=[
        {
            **{"scenario": "paper", "steps": 30},
            **{"settings": ["default", "high"], "policies": ["fresh", "warm"]},
        }
    ],
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_suite(tmp_path_factory.mktemp("campaign"), SUITE)


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return load_results(folder)


def test_the_folder_has_the_suite_that_runs_it_again(folder: Path, results: Results) -> None:
    """Rows under a second name of the same settings have cells of their own."""
    plan = RunRequest(str(folder / "suite.toml")).make_plan()
    again = {planned.cell.to_json() for planned in plan.cells}
    names = sum(1 + len(planned.alias_settings) for planned in plan.cells)
    assert again <= set(results.runs["cell"]) and names == len(results.runs)


def test_tables_have_exactly_the_columns_of_the_schema(results: Results) -> None:
    assert list(results.runs.columns) == list(RUN_COLUMNS)
    assert list(results.steps.columns) == list(STEP_COLUMNS)


def test_sums_and_changes_of_steps_follow_from_other_columns(results: Results) -> None:
    steps = results.steps.merge(results.runs[["run_id", "mode", "sample_s"]], on="run_id")
    phases = ["setup_ns", "update_ns", "solve_ns", "read_ns"]
    timed = steps[steps[phases].notna().any(axis=1)]
    assert len(timed) and (timed["total_ns"] == timed[phases].sum(axis=1)).all()
    loops = steps[steps["mode"] == "closed_loop"]
    for axis in AXIS_FORCES:
        before = loops.groupby("run_id", observed=True)[f"tau_{axis}"].shift().fillna(0.0)
        np.testing.assert_array_equal(loops[f"dtau_{axis}"], loops[f"tau_{axis}"] - before)
    np.testing.assert_array_equal(loops["t_s"], loops["k"] * loops["sample_s"])


def test_rows_tell_how_their_library_was_built(results: Results) -> None:
    builds = results.runs.groupby("solver")["build"].unique()
    assert list(builds["osqp"]) == [f"algebra {osqp.default_algebra()}"]
    assert list(builds["quadprog"]) == [""]
    assert not results.runs["generic_build"].any()


def test_every_planned_cell_is_a_row(results: Results) -> None:
    runs = results.runs
    closed = runs[runs["mode"] == "closed_loop"]
    assert len(closed) == 3 + 2 * 2, "two solvers and the baseline_law; SI at two settings each"
    replayed = runs[runs["mode"] == "replay"]
    assert len(replayed) == 2 * 2 * 2
    refused = replayed[replayed["outcome"] == "refused"]
    assert set(refused["solver"]) == {"quadprog"} and (refused["policy"] == "warm").all()
    assert refused["outcome_detail"].str.contains("start").all()
    assert (runs["study"] == "").all(), "no row of any kind is of a study"
    assert (runs.loc[runs["outcome"] != "refused", "outcome"] == "finished").all()


def test_settings_without_effect_run_once_and_show_under_both_names(results: Results) -> None:
    runs = results.runs
    pair = runs[(runs["solver"] == "quadprog") & (runs["units"] == "si")]
    assert sorted(pair["settings"]) == ["default", "high"]
    assert pair["run_id"].nunique() == 2
    assert pair["raw_max_ns"].nunique() == 1


def test_loops_alone_have_times_of_emission(results: Results) -> None:
    steps = results.steps
    assert (steps["total_ns"] > 0).all()
    loops = steps["run_id"].isin(results.runs.loc[results.runs["mode"] == "closed_loop", "run_id"])
    assert steps.loc[loops, "emit_ns"].notna().all()
    assert steps.loc[~loops, "emit_ns"].isna().all()


def test_replay_rows_carry_no_ship_columns(results: Results) -> None:
    runs = results.runs
    ids = runs.loc[(runs["mode"] == "replay") & (runs["outcome"] == "finished"), "run_id"]
    rows = results.steps[results.steps["run_id"].isin(ids)]
    assert rows[["n_m", "psi_rad", "tau_x_N", "dtau_n_Nm"]].isna().all().all()
    one = rows[rows["run_id"] == ids.iloc[0]]
    assert one["warmup"].sum() == 5
    assert one.loc[~one["warmup"]].groupby("repeat").size().tolist() == [30, 30]


def test_replayed_qps_are_the_same_for_every_configuration(results: Results) -> None:
    runs = results.runs
    ids = runs.loc[(runs["mode"] == "replay") & (runs["outcome"] == "finished"), "run_id"]
    first = results.steps[~results.steps["warmup"]].drop_duplicates(["run_id", "k"])
    table = first[first["run_id"].isin(ids)].pivot(index="k", columns="run_id", values="n_active")
    assert (table.nunique(axis=1) == 1).all()


def test_the_exact_solver_deviates_from_the_exact_loop_by_rounding(results: Results) -> None:
    runs = results.runs
    row = runs[
        (runs["solver"] == "quadprog")
        & (runs["mode"] == "closed_loop")
        & (runs["units"] == "scaled")
    ].iloc[0]
    assert row["dev_position_max_m"] < 1e-9
    assert row["limit_violations"] == 0
    assert row["steps_done"] == row["steps_planned"] == 30


def test_a_cell_runs_again_from_its_json(results: Results) -> None:
    for text in results.runs["cell"]:
        cell = Cell.from_json(text)
        assert cell.to_json() == text
        assert json.loads(text)["scenario"]["scenario"]["sample_s"] == 0.3


def test_unknown_names_are_refused_before_anything_runs(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UnknownNameError, match=r"allowed: standard, .*list_suites\(\)`"):
        run_campaign("standrad", out)
    with pytest.raises(UnknownNameError, match="quadprog"):
        run_campaign("smoke", out, solvers=["quadprgo"])
    with pytest.raises(UnknownNameError, match="allowed: rough, "):
        run_campaign("smoke", out, scenarios=["ruogh"])
    with pytest.raises(InputError, match="`steps`: found 0"):
        run_campaign("smoke", out, steps=0)
    with pytest.raises(InputError, match="allowed: 1 to"):
        run_campaign("smoke", out, jobs=0)
    assert not out.exists()


def test_damaged_results_are_said_in_one_line(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="no such folder"):
        load_results(tmp_path / "nowhere")
    with pytest.raises(ResultsError, match=r"runs\.parquet: no such file"):
        load_results(tmp_path)
    for name in ("runs.parquet", "steps.parquet", "machine.json", "suite.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "steps.parquet").write_bytes((folder / "steps.parquet").read_bytes()[:1000])
    with pytest.raises(ResultsError, match=r"steps\.parquet: found a damaged file"):
        load_results(tmp_path)
    (tmp_path / "steps.parquet").write_bytes((folder / "steps.parquet").read_bytes())
    (tmp_path / "machine.json").write_text("{", encoding="utf-8")
    with pytest.raises(ResultsError, match=r"machine\.json: found invalid JSON"):
        load_results(tmp_path)


def test_a_part_has_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_campaign("smoke", solvers=["quadprog"]) == Path("results/smoke-part")


def test_a_folder_with_other_things_is_left_alone(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="results of suite 'tiny'"):
        run_campaign("smoke", folder)
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "report.html").write_text("my own", encoding="utf-8")
    with pytest.raises(InputError, match="mine, a folder with files that no run has written"):
        run_campaign("smoke", mine)
    assert (mine / "report.html").read_text(encoding="utf-8") == "my own"
    with pytest.raises(InputError, match="can be written"):
        run_campaign("smoke", mine / "report.html" / "below")
    with pytest.raises(InputError, match="current folder"):
        run_campaign("smoke", "")


def test_tables_that_do_not_belong_together_are_refused(folder: Path, tmp_path: Path) -> None:
    for name in ("runs.parquet", "steps.parquet", "machine.json", "suite.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    steps = pd.read_parquet(folder / "steps.parquet")
    steps.head(len(steps) // 2).to_parquet(tmp_path / "steps.parquet")
    with pytest.raises(ResultsError, match="step_rows"):
        load_results(tmp_path)
    steps.assign(total_ns="slow").to_parquet(tmp_path / "steps.parquet")
    with pytest.raises(ResultsError, match="column of another type"):
        load_results(tmp_path)


def test_scenarios_of_one_name_are_refused(tmp_path: Path) -> None:
    text = find_problem_path("scenarios", "paper").read_text(encoding="utf-8")
    for part in ("a", "b"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "paper.toml").write_text(text, encoding="utf-8")
    loop = {"scenarios": ["a/paper.toml", "b/paper.toml"]}
    with pytest.raises(InputError, match="two scenarios called 'paper'"):
        run_suite(tmp_path, suite_toml(closed_loop=[loop]))


def test_a_plug_in_runs_in_a_process_of_its_own(tmp_path: Path) -> None:
    module = Path(__file__).parents[1] / "solvers" / "example_plugin.py"
    loop = {"scenarios": ["calm"], "settings": ["high"], "steps": 20}
    text = suite_toml(closed_loop=[loop])
    out = run_suite(tmp_path, text, solvers=["admm"], solver_module=module)
    (row,) = load_results(out).runs.to_dict("records")
    assert (row["solver"], row["outcome"], row["steps_done"]) == ("admm", "finished", 20)
    assert row["true_share"] == 1.0
