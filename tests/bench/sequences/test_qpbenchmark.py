"""A test set for qpbenchmark: it runs as it is, and its residuals are ours."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import InputError, Solution, Status, load_scenario, residuals
from dpbench.bench.sequences.export import export_sequence, save_qpbenchmark
from dpbench.bench.sequences.sequence_file import Recorded, load_recorded
from dpbench.bench.sequences.source import record_scenario
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.random_sequence import RandomRecipe, generate_random_sequence
from dpbench.qp.referee.referee import certify_all_steps

SOLVERS = ("daqp", "osqp")
RTOL = 1e-9
ROUNDING = 1e-13
"""Rounding error of sums of some 30 terms of size 10, which the two add in another order."""


def mixed() -> Recorded:
    """Equality, one-sided and free rows, which change from step to step, and infinite bounds."""
    rng = np.random.default_rng(5)
    n, K = 4, 6
    L = rng.standard_normal((n, n))
    A = rng.standard_normal((3, n))
    q = rng.standard_normal((K, n))
    low = np.tile([-0.2, -np.inf, 0.1], (K, 1))
    high = np.tile([0.3, 0.2, 0.1], (K, 1))
    low[3:, 0], high[3:, 0], low[3:, 2], high[3:, 2] = -np.inf, np.inf, -0.1, np.inf
    lb, ub = np.array([-1.0, -np.inf, -0.5, -1.0]), np.array([1.0, 2.0, np.inf, 0.5])
    base = QuadraticProgram(L @ L.T + np.eye(n), q[0], A, low[0], high[0], lb, ub)
    sequence = QPSequence("mixed", base, q, low, high)
    return Recorded(sequence, certify_all_steps(sequence))


def two_sided(qp: QuadraticProgram, answer: Any) -> Solution:
    """The answer of qpsolvers with a multiplier per row: upper sides come before lower ones."""
    equal = qp.l == qp.u
    upper = np.flatnonzero(~equal & np.isfinite(qp.u))
    lower = np.flatnonzero(~equal & np.isfinite(qp.l))
    y = np.zeros(qp.m)
    if len(upper) + len(lower):
        y[upper] += answer.z[: len(upper)]
        y[lower] -= answer.z[len(upper) :]
    if equal.any():
        y[equal] = answer.y
    return Solution(Status.SOLVED, answer.x, y, answer.z_box)


@pytest.fixture(scope="module")
def qpbenchmark() -> Any:
    return pytest.importorskip("qpbenchmark", reason="qpbenchmark is not installed")


@pytest.mark.slow
# qpsolvers leaves out an argument whose default osqp is going to change; raised as an error, the
# warning would count as a failure of the solver.
@pytest.mark.filterwarnings("ignore:The default value of raise_error:PendingDeprecationWarning")
@pytest.mark.parametrize("kind", ["paper_tight", "mixed"])
def test_residuals_agree_row_by_row(kind: str, qpbenchmark: Any, tmp_path: Path) -> None:
    tight = kind == "paper_tight"
    recorded = record_scenario(load_scenario(kind), steps=24, every=3) if tight else mixed()
    _, code = save_qpbenchmark(tmp_path / "dp_set.py", recorded)
    kept: dict[tuple[str, str], Any] = {}

    class Keeping(qpbenchmark.Results):  # type: ignore[misc] # qpbenchmark has no types
        def update(
            self, problem: Any, solver: str, settings: str, solution: Any, time: float
        ) -> None:
            kept[problem.name, solver] = solution
            super().update(problem, solver, settings, solution, time)

    from qpbenchmark.benchmark import load_test_set

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", list(sys.path))
        patch.delitem(sys.modules, "dp_set", raising=False)
        test_set = load_test_set(str(code))
        patch.delitem(sys.modules, "dp_set", raising=False)
    results = Keeping(tmp_path / "results.csv", test_set)
    for solver in SOLVERS:
        qpbenchmark.run(test_set, results, only_solver=solver, only_settings="low_accuracy")
    names = [problem.name for problem in test_set]
    assert len(names) == len(set(names)) == len(recorded.sequence)
    rows = pd.read_csv(tmp_path / "results.csv").set_index(["problem", "solver"])
    assert len(rows) == len(names) * len(SOLVERS) and rows["found"].all()
    # Answers of low accuracy, so that the numbers compared are more than rounding.
    assert rows.loc[(slice(None), "osqp"), "dual_residual"].max() > 1e-6
    for k, name in enumerate(names):
        qp = recorded.sequence.problem(k)
        for solver in SOLVERS:
            theirs, ours = rows.loc[name, solver], residuals(qp, two_sided(qp, kept[name, solver]))
            close = {"rtol": RTOL, "atol": ROUNDING}
            np.testing.assert_allclose(ours.primal, theirs["primal_residual"], **close)
            np.testing.assert_allclose(ours.dual, theirs["dual_residual"], **close)
            assert theirs["duality_gap"] <= ours.gap * (1.0 + RTOL) + ROUNDING


@pytest.mark.slow
def test_its_command_runs_the_set_as_it_is(qpbenchmark: Any, tmp_path: Path) -> None:
    """`qpbenchmark dp_calm.py run` in the folder of the files solves each and writes its report."""
    said = export_sequence("calm", tmp_path / "dp_calm", format="qpbenchmark", steps=4)
    assert said.startswith(f"{tmp_path / 'dp_calm.parquet'} and {tmp_path / 'dp_calm.py'}: 4 QPs")
    command = [sys.executable, "-m", "qpbenchmark.benchmark", "--results-path", "results.csv"]
    command += ["dp_calm.py", "run", "--solver", "daqp", "--author", "nobody"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = pd.read_csv(tmp_path / "results.csv")
    assert sorted(set(rows["problem"])) == [f"calm_{k}" for k in range(4)]
    assert rows["found"].all() and (rows["primal_residual"] < 1e-9).all()
    assert "dpbench calm" in (tmp_path / "dp_calm.md").read_text(encoding="utf-8")


def test_the_table_holds_the_problems(tmp_path: Path) -> None:
    recorded = mixed()
    table, _ = save_qpbenchmark(tmp_path / "dp_set.parquet", recorded)
    frame = pd.read_parquet(table)
    assert list(frame.columns) == ["P", "q", "G", "h", "A", "b", "lb", "ub", "name"]
    assert recorded.optima is not None
    for row, optimum in zip(frame.to_dict("records"), recorded.optima, strict=True):
        z, n = optimum.z, 4
        assert (row["G"].reshape(-1, n) @ z <= row["h"] + 1e-12).all()
        assert (row["lb"] <= z + 1e-12).all() and (z <= row["ub"] + 1e-12).all()
    # Two rows of three sides and an equality; then two upper or lower sides and no equality.
    assert [len(h) for h in frame["h"]] == [3, 3, 3, 2, 2, 2]
    assert frame["b"].iloc[0].tolist() == [0.1] and frame["b"].iloc[5] is None


def test_steps_without_an_optimum_are_left_out(tmp_path: Path) -> None:
    recipe = RandomRecipe("infeasible_steps", 4, 6, 1, steps=6)
    sequence = generate_random_sequence(recipe)
    table, _ = save_qpbenchmark(
        tmp_path / "some.py", Recorded(sequence, certify_all_steps(sequence))
    )
    # Every third step of this family contradicts itself.
    names = pd.read_parquet(table)["name"].tolist()
    assert [name.rpartition("_")[2] for name in names] == ["0", "1", "3", "4"]


@pytest.mark.parametrize("name", ["two words.py", "json.py", "numpy", "9lives.py", "dp.npz"])
def test_a_name_that_cannot_be_imported_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`out`"):
        save_qpbenchmark(tmp_path / name, mixed())
    assert not list(tmp_path.iterdir())


def test_both_formats_come_from_the_same_record(tmp_path: Path) -> None:
    """The P of the Parquet row is that of the `.npz` it was made from, bit for bit."""
    export_sequence("paper", tmp_path / "a.npz", steps=3)
    export_sequence(tmp_path / "a.npz", tmp_path / "dp_a.py", format="qpbenchmark", every=2)
    sequence = load_recorded(tmp_path / "a.npz").sequence
    frame = pd.read_parquet(tmp_path / "dp_a.parquet")
    assert frame["name"].tolist() == ["paper_0", "paper_2"]
    for k, row in zip((0, 2), frame.to_dict("records"), strict=True):
        np.testing.assert_array_equal(row["P"].reshape(15, 15), sequence.base.P)
        np.testing.assert_array_equal(row["q"], sequence.q[k])
        np.testing.assert_array_equal(row["h"], np.concatenate((sequence.u[k], -sequence.l[k])))
