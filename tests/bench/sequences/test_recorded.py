"""Recordings of others: a folder of problems by qpsolvers, or our own file, through the solvers."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from qpsolvers import Problem
from scipy.sparse import csc_matrix

from dpbench import InputError, load_results, load_scenario, run_campaign, save_sequence
from dpbench.bench.plan.cells import SEMIDEFINITE_REFUSAL
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import RecordedTable, SuiteFile, build_sequence_suite
from dpbench.bench.record.cell import Cell
from dpbench.bench.sequences.sequence_file import read_problems
from dpbench.bench.sequences.source import record_scenario
from dpbench.cli.main import main
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.report.write import write_report

TARGETS = {2: -0.75, 10: -0.5, 11: 2.0}
"""Number of the file and the a of its problem; by the alphabet 10 and 11 come before 2."""
LIMIT = 1.0


def hand_made(a: float) -> Problem:
    """min ½x₀² − a·x₀ + x₁  with  x₀ + x₁ = 3,  x₀ ≤ 1,  x₂ = 0.5 by its bounds; P is singular."""
    return Problem(
        np.diag([1.0, 0.0, 0.0]),
        np.array([-a, 1.0, 0.0]),
        np.array([[1.0, 0.0, 0.0]]),
        np.array([LIMIT]),
        np.array([[1.0, 1.0, 0.0]]),
        np.array([3.0]),
        np.array([-9.0, -9.0, 0.5]),
        np.array([9.0, 9.0, 0.5]),
    )


def optimum(a: float) -> list[float]:
    """With x₁ = 3 − x₀ the cost is ½x₀² − (a + 1)·x₀ + 3: its minimum is at a + 1, or the limit."""
    best = min(a + 1.0, LIMIT)
    return [best, 3.0 - best, 0.5]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "robot"
    place.mkdir()
    for number, a in TARGETS.items():
        hand_made(a).save(str(place / f"step_{number}.npz"))
    (place / "notes.txt").write_text("no problem", encoding="utf-8")
    return place


def test_files_come_in_natural_order_with_the_optima_of_a_hand_calculation(folder: Path) -> None:
    """Equality rows, a singular P and a fixed variable are read, certified, and 2 is before 10."""
    sequence = read_problems(folder)
    assert (sequence.name, len(sequence), sequence.P, sequence.lb) == ("robot", 3, None, None)
    assert sequence.base.l.tolist() == [-np.inf, 3.0]
    assert sequence.q[:, 0].tolist() == [0.75, 0.5, -2.0]
    for found, a in zip(certify_all_steps(sequence), TARGETS.values(), strict=True):
        assert found.bound < 1e-9
        np.testing.assert_allclose(found.z, optimum(a), atol=1e-9)


def test_what_changes_between_files_stands_per_step(folder: Path) -> None:
    other = hand_made(0.5)
    other.P, other.ub = 2.0 * other.P, np.array([9.0, 8.0, 0.5])
    other.save(str(folder / "step_10.npz"))
    sequence = read_problems(folder)
    assert sequence.P is not None and sequence.ub is not None and sequence.A is None
    assert sequence.P[:, 0, 0].tolist() == [1.0, 2.0, 1.0]
    assert sequence.ub[:, 1].tolist() == [9.0, 8.0, 9.0]
    # With x₀² instead of ½x₀² the minimum is at (a + 1)/2.
    np.testing.assert_allclose(certify_all_steps(sequence)[1].z, [0.75, 2.25, 0.5], atol=1e-9)


def test_a_problem_without_rows_or_bounds_is_read(tmp_path: Path) -> None:
    Problem(np.eye(2), np.array([1.0, -2.0])).save(str(tmp_path / "0.npz"))
    sequence = read_problems(tmp_path)
    assert sequence.base.m == 0 and np.isinf(sequence.base.lb).all()
    np.testing.assert_allclose(certify_all_steps(sequence)[0].z, [-1.0, 2.0], atol=1e-12)
    G, h = np.array([1.0, 1.0]), np.array([0.0])
    Problem(np.eye(2), np.array([1.0, -2.0]), G, h).save(str(tmp_path / "0.npz"))
    sequence = read_problems(tmp_path)
    assert sequence.base.m == 1
    np.testing.assert_allclose(certify_all_steps(sequence)[0].z, [-1.5, 1.5], atol=1e-12)


Arrays = dict[str, Any]


def put(name: str, value: object) -> Callable[[Arrays], Arrays]:
    return lambda a: a | {name: np.asarray(value)}


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (put("P", np.eye(2)), ["P", "(2, 2)", "(3, 3)"]),
        (put("P", np.eye(3) + np.eye(3, k=1)), ["P[0, 1]", "symmetric"]),
        (put("q", [1.0, np.nan, 0.0]), ["q[1]", "nan", "finite"]),
        (put("q", 1.0), ["q", "missing", "(n,)"]),
        (put("h", [-np.inf]), ["h[0]", "-inf", "+inf"]),
        (put("b", [np.inf]), ["b[0]", "inf", "finite numbers"]),
        (put("b", [1.0, 2.0]), ["b", "(2,)", "(1,)"]),
        (put("lb", [np.inf, 0.0, 0.0]), ["lb[0]", "inf"]),
        (put("x0", [1.0]), ["x0", "unknown"]),
        (lambda a: {k: v for k, v in a.items() if k != "h"}, ["h", "missing", "G and h"]),
        (lambda a: {k: v for k, v in a.items() if k != "P"}, ["P", "missing", "array"]),
        (put("G", np.array(csc_matrix(np.eye(3)))), ["G", "sparse", "dense"]),
        (
            lambda a: a | {"G": np.ones((2, 3)), "h": np.ones(2)},
            ["3 variables, 3 rows", "3 variables, 2 rows", "step_2.npz"],
        ),
    ],
)
def test_bad_problems(change: Callable[[Arrays], Arrays], parts: list[str], folder: Path) -> None:
    with np.load(folder / "step_10.npz", allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    np.savez(folder / "step_10.npz", **change(arrays))
    with pytest.raises(InputError) as caught:
        read_problems(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert all(part in message for part in ["step_10.npz", *parts]), message


@pytest.mark.slow
def test_a_folder_runs_through_the_solvers(folder: Path, tmp_path: Path) -> None:
    """Every solver at two settings; one that needs P > 0 is refused; the report is written."""
    solvers = ["daqp", "quadprog", "clarabel"]
    out = run_campaign(None, tmp_path / "out", sequence=folder, solvers=solvers)
    runs = load_results(out).runs
    assert set(runs["sequence"]) == {"robot"} and set(runs["scenario"]) == {""}
    refused = runs[runs["solver"] == "quadprog"]
    assert set(refused["outcome"]) == {"refused"}
    assert set(refused["outcome_detail"]) == {SEMIDEFINITE_REFUSAL}
    tight = runs[(runs["solver"] == "clarabel") & (runs["settings"] == "high")].iloc[0]
    assert (tight["outcome"], tight["steps_done"], tight["uncertified"]) == ("finished", 3, 0)
    assert tight["error_move_max"] < 1e-6 and tight["claimed_not_true"] == 0
    steps = load_results(out).steps
    assert steps["t_s"].isna().all()
    assert "robot" in write_report(out).read_text(encoding="utf-8")


@pytest.mark.slow
def test_our_own_file_runs_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["export", "turn", "--steps", "13", "--every", "4", "--horizons", "20/4"]
    assert main([*arguments, "--out", "turn.npz"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("turn.npz: 4 QPs, n = 12, m = 12; certificates: 4 linear")
    assert main(["run", "--sequence", "turn.npz", "--solver", "daqp"]) == 0
    results = load_results("results/sequence-turn-part")
    assert (results.runs["error_move_max"] < 1e-9).all()
    assert set(results.runs["settings"]) == {"default", "high"}
    sample_s = load_scenario("turn").sample_s
    np.testing.assert_allclose(sorted(set(results.steps["t_s"])), sample_s * np.arange(0, 13, 4))
    cell = json.loads(results.runs["cell"].iloc[0])
    assert cell["source"]["path"] == "turn.npz"
    capsys.readouterr()
    assert main(["run", "--sequence", "papr-60-10"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "allowed: paper-60-10" in said


@pytest.mark.slow
def test_a_lie_in_a_file_is_not_believed(tmp_path: Path) -> None:
    """Optima that a file claims with a bound of 0 are certified again by whoever replays it."""
    recorded = record_scenario(load_scenario("paper"), steps=3)
    assert recorded.optima is not None
    false = [type(o)(o.z + 1.0, o.y, o.y_box, 0.0, o.kind) for o in recorded.optima]
    save_sequence(tmp_path / "false.npz", recorded.sequence, false)
    out = run_campaign(None, tmp_path / "o", sequence=tmp_path / "false.npz", solvers=["daqp"])
    assert (load_results(out).runs["error_move_max"] < 1e-9).all()


def test_a_file_changed_since_the_cell_was_planned_is_another(folder: Path) -> None:
    suite = build_sequence_suite(folder)
    before = plan_suite(suite, solvers=["daqp"])[0].cell
    assert Cell.from_json(before.to_json()).to_json() == before.to_json()
    hand_made(3.0).save(str(folder / "step_11.npz"))
    after = plan_suite(suite, solvers=["daqp"])[0].cell
    assert before.source != after.source
    assert before.problem_key != after.problem_key


def test_a_suite_names_a_sequence_beside_it(folder: Path) -> None:
    suite = SuiteFile(title="x", solvers=["daqp"], recorded=[RecordedTable(sequence="robot")])
    (planned,) = plan_suite(suite, beside=folder.parent)
    assert (planned.cell.sequence, planned.cell.steps) == ("robot", 3)
    sparse_equivalent = folder.parent / "sparse_equivalent" / "robot"
    sparse_equivalent.mkdir(parents=True)
    hand_made(3.0).save(str(sparse_equivalent / "0.npz"))
    both = [RecordedTable(sequence="robot"), RecordedTable(sequence=str(sparse_equivalent))]
    with pytest.raises(InputError, match="'robot'"):
        plan_suite(SuiteFile(title="x", solvers=["daqp"], recorded=both), beside=folder.parent)


@pytest.mark.slow
def test_an_exported_random_mpc_problem_is_replayed(tmp_path: Path) -> None:
    """The file holds the certified optima; the solver's answers are judged by them."""
    path = tmp_path / "random.npz"
    assert main(["export", "random_mpc-3-2-4-s7", "--steps", "3", "--out", str(path)]) == 0
    out = run_campaign(None, tmp_path / "out", sequence=path, solvers=["daqp"])
    runs = load_results(out).runs
    assert set(runs["steps_done"]) == {3}
    assert runs["error_plan_max"].max() < 1e-9
