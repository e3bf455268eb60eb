"""OCP QPs of acados and Maros-Meszaros problems, against optima found without the converter."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from dpbench import InputError, export_sequence, load_results, load_sequence, run_campaign
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.plan.run_request import WITHOUT_SAMPLE, RunRequest
from dpbench.bench.record.energy import find_energy_counters
from dpbench.bench.sequences.foreign_qps import read_acados_qp, read_maros_meszaros_problem
from dpbench.bench.sequences.sequence_file import read_problems
from dpbench.bench.sequences.source import load_named_sequence
from dpbench.cli.check import check_file
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.report.report import Report

INFINITY = 1e10  # of acados

Fields = dict[str, Any]


def two_stages(lowest_u: float = -INFINITY) -> Fields:
    """x₁ = x₀ + u₀ + 0.5 from x₀ = 1: minimise ½u₀² + 0.2·u₀x₀ + 0.1·u₀ + ½x₁², unused parts empty.

    Its derivative is u₀ + 0.2 + 0.1 + (1.5 + u₀): the minimum is at u₀ = −0.9, x₁ = 0.6.
    """
    stage_0: Fields = {
        **{"A": [[1.0]], "B": [[1.0]], "b": [[0.5]], "Q": [[0.0]], "R": [[1.0]], "S": [[0.2]]},
        **{"q": [[0.0]], "r": [[0.1]], "lbx": [[1.0]], "ubx": [[1.0]], "lbu": [[lowest_u]]},
        **{"ubu": [[INFINITY - 1.0]], "idxb": [[0], [1]]},
    }
    stage_1 = {"Q": [[1.0]], "q": [[0.0]], "B": [[]]}
    stages = enumerate((stage_0, {key: stage_1[key] for key in ("Q", "q")}))
    return {f"{field}_{k}": value for k, stage in stages for field, value in stage.items()}


def write(path: Path, fields: Fields) -> Path:
    path.write_text(json.dumps(fields), encoding="utf-8")
    return path


def solve(path: Path) -> list[float]:
    (found,) = certify_all_steps(read_problems(path))
    assert found.bound < 1e-9
    return found.z.tolist()


@pytest.mark.parametrize(("lowest", "u"), [(-INFINITY, -0.9), (-0.5, -0.5)])
def test_two_stages_have_the_optimum_of_a_hand_calculation(
    lowest: float, u: float, tmp_path: Path
) -> None:
    path = write(tmp_path / "qp.json", two_stages(lowest))
    assert solve(path) == pytest.approx([u, 1.0, 1.5 + u], abs=1e-9)
    assert check_file(str(path)).startswith(f"{path}: 1 QP, n = 3, m = 1")
    # Without `idxb`, as of older versions: all entries have bounds.
    older = {key: value for key, value in two_stages(lowest).items() if key != "idxb_0"}
    assert solve(write(path, older)) == pytest.approx([u, 1.0, 1.5 + u], abs=1e-9)


def test_a_row_and_a_bound_of_some_states_are_at_their_places(tmp_path: Path) -> None:
    rows = {"C_0": [[2.0]], "D_0": [[1.0]], "lg_0": [1.4], "ug_0": [INFINITY]}
    path = write(tmp_path / "qp.json", two_stages() | rows)
    # 2·1 + u₀ ≥ 1.4 is more than the minimum has.
    assert solve(path) == pytest.approx([-0.6, 1.0, 0.9], abs=1e-9)
    wide = {"Q_1": np.diag([1.0, 2.0]).tolist(), "q_1": [0.0, 0.0], "A_0": [[1.0], [0.0]]}
    wide |= {"B_0": [[1.0], [0.0]], "b_0": [0.5, 3.0], "lbx_1": [2.5], "ubx_1": [3.0]}
    qp = read_acados_qp(write(path, two_stages() | wide | {"idxb_1": [1]}))
    assert (qp.lb.tolist()[2:], qp.ub.tolist()[2:]) == ([-np.inf, 2.5], [np.inf, 3.0])
    assert solve(path) == pytest.approx([-0.9, 1.0, 0.6, 3.0], abs=1e-9)


def test_a_horizon_has_the_inputs_of_a_riccati_recursion(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    A, B, x = rng.normal(size=(2, 2)), rng.normal(size=(2, 1)), np.array([1.0, -2.0])
    Q, R, N = np.diag([2.0, 1.0]), np.array([[0.5]]), 11
    fields: Fields = {f"Q_{k:02d}": Q.tolist() for k in range(N + 1)}
    fields |= {f"q_{k:02d}": [0.0, 0.0] for k in range(N + 1)}
    stage = {"A": A, "B": B, "b": np.zeros((2, 1)), "R": R, "S": np.zeros((1, 2)), "r": [[0.0]]}
    for k in range(N):
        fields |= {f"{key}_{k:02d}": np.array(value).tolist() for key, value in stage.items()}
    fields |= {"lbx_00": x.tolist(), "ubx_00": x.tolist()}
    gains, P = [], Q
    for _ in range(N):
        gains.append(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A))
        P = Q + A.T @ P @ (A - B @ gains[-1])
    wanted = []
    for gain in reversed(gains):
        wanted.append(float((-gain @ x)[0]))
        x = A @ x + B @ [wanted[-1]]
    assert solve(write(tmp_path / "qp.json", fields))[0 : 3 * N : 3] == pytest.approx(wanted)


def put(key: str, value: object) -> Callable[[Fields], Fields]:
    return lambda fields: fields | {key: value}


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (put("A_0", [[1.0, 2.0]]), ["stage 0", "A", "(1, 2)", "(1, 1)"]),
        (put("Q_0", [[1.0], [1.0, 2.0]]), ["Q_0", "unequal"]),
        (put("r_0", ["one"]), ["stage 0", "r", "real numbers"]),
        (put("b_0", [float("nan")]), ["stage 0", "b", "finite"]),
        (put("idxb_0", [0, 2]), ["stage 0", "idxb", "0 to 1"]),
        (put("idxs_0", [0]), ["idxs_0", "soft constraints"]),
        (put("W_0", [[1.0]]), ["W_0", "unknown"]),
        (put("Q_3", [[1.0]]), ["all stages", "without some of its stages"]),
        (put("Q_1", [[1.0]] * 1999), ["2001", "1 to 2000"]),
        (lambda fields: {}, ["no stages"]),
        (lambda fields: {k: v for k, v in fields.items() if k != "B_0"}, ["B", "missing"]),
    ],
)
def test_bad_dumps(change: Callable[[Fields], Fields], parts: list[str], tmp_path: Path) -> None:
    path = write(tmp_path / "qp.json", change(two_stages()))
    with pytest.raises(InputError) as caught:
        read_acados_qp(path)
    message = str(caught.value)
    assert "\n" not in message and all(part in message for part in ["qp.json", *parts]), message


@pytest.mark.slow
def test_a_folder_of_dumps_runs_and_is_said_to_have_no_sample(tmp_path: Path) -> None:
    (tmp_path / "robot").mkdir()
    for k, lowest in enumerate((-INFINITY, -0.5)):
        write(tmp_path / "robot" / f"qp_{k}.json", two_stages(lowest))
    folder = tmp_path / "robot"
    solvers = ["clarabel", "quadprog"]
    assert WITHOUT_SAMPLE in RunRequest(sequence=str(folder), solvers=solvers).make_plan().remarks
    out = run_campaign(None, tmp_path / "out", sequence=folder, solvers=solvers)
    results = load_results(out)
    assert not Requirements.from_suite(results.suite).judges_step_times
    report = Report.from_results(results)
    assert "no deadline is known" in report.recommendation.requirements and report.figures
    runs = results.runs.set_index(["solver", "settings"])
    assert set(runs.loc["quadprog", "outcome"]) == {"refused"}
    assert runs.loc[("clarabel", "high"), "error_move_max"] < 1e-6
    energy_J = runs["energy_J_per_step"]
    assert energy_J.isna().all() or not find_energy_counters().missing


def maros_meszaros() -> Fields:
    """min x₀² − 2x₀ + x₁  with  x₀ + x₁ = 3,  x₁ ≥ 2.5 by its bound: x = (0.5, 2.5)."""
    return {
        "P": scipy.sparse.csc_matrix(np.diag([2.0, 0.0])),
        "q": np.array([[-2.0], [1.0]]),
        "A": scipy.sparse.csc_matrix([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]),
        "l": np.array([[3.0], [-1e20], [2.5]]),
        "u": np.array([[3.0], [1e20], [1e20]]),
        **{"n": 2.0, "m": 3.0, "r": 0.0},
    }


@pytest.mark.slow
def test_a_maros_meszaros_problem_has_its_optimum_or_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "HS99.mat"
    scipy.io.savemat(path, maros_meszaros())
    sequence = load_named_sequence(path).sequence
    assert (sequence.name, sequence.base.m, sequence.base.ub.tolist()) == ("HS99", 1, [np.inf] * 2)
    assert solve(path) == pytest.approx([0.5, 2.5], abs=1e-9)
    export_sequence(path, tmp_path / "HS99.npz")
    assert len(load_sequence(tmp_path / "HS99.npz")) == 1
    bad = {"A": np.ones((3, 2)), "l": np.zeros(1), "q": np.zeros((2001, 1))}
    for name, value in bad.items():
        scipy.io.savemat(path, maros_meszaros() | {name: value})
        with pytest.raises(InputError, match=r"HS99\.mat"):
            read_maros_meszaros_problem(path)
