"""Counts of solvers' C along a short sequence: stored ones, repeated ones, and their answers."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import osqp
import pytest
import scipy

from dpbench import open_workspace
from dpbench.bench.sequences.sequence_file import load_sequence
from dpbench.bench.sequences.source import thin_sequence
from dpbench.embedded.count import count_instructions_along_sequence
from dpbench.embedded.recipe import select_recipes
from dpbench.embedded.table import (
    StepCounts,
    save_counted_steps_in_folder,
    summarise_counted_runs,
    tabulate_counted_steps,
)
from dpbench.embedded.toolchain import TARGETS, compiler_version, has_extra
from dpbench.errors import InputError, SituationError
from dpbench.qp.program import QPSequence
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.solvers.contract import HIGH, Settings

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("embedded_extra")]
STORED = {
    ("daqp", "m7"): [88279, 27875, 20246, 48214, 15483],
    ("daqp", "a53"): [74525, 24473, 17624, 40905, 13349],
    ("osqp", "m7"): [2811077, 2617679, 3912306, 6368492, 5612928],
    ("osqp", "a53"): [2184329, 2033991, 3041167, 4952497, 4364945],
    ("paper_active_set", "m7"): [32037, 15007, 11147, 17815, 7475],
    ("paper_active_set", "a53"): [27735, 13605, 9992, 15571, 6414],
}
"""Instructions of the first five steps of paper-30-5, by ziglang as pinned in constraints.txt."""
PINNED = "0.17.1"
HPIPM = os.environ.get("DPBENCH_HPIPM_SOURCES", "")
"""Folder with HPIPM's and BLASFEO's sources, which no package has."""
SOFT = "thruster_loss_soft-30-5"


def load(name: str, steps: int) -> QPSequence:
    """The first QPs of a stored sequence."""
    return thin_sequence(load_sequence(name), steps)


def count(solver: str, target: str, sequence: QPSequence, **options: Any) -> StepCounts:
    """Count a solver; a test is skipped where its source is missing or cannot be fetched."""
    given = {"hpipm": Path(HPIPM)} if HPIPM else {}
    (recipe,) = select_recipes([solver], sources=given)
    if recipe.missing:
        pytest.skip(recipe.missing)
    try:
        return count_instructions_along_sequence(recipe, sequence, TARGETS[target], **options)
    except SituationError as error:
        if "cannot fetch" in str(error):
            pytest.skip(str(error))
        raise


@pytest.mark.skipif(
    not has_extra() or compiler_version() != PINNED, reason="counts are of the pinned compiler"
)
@pytest.mark.parametrize(("solver", "target"), STORED)
def test_counts_equal_stored_ones(solver: str, target: str) -> None:
    counts = count(solver, target, load("paper-30-5", 5))
    assert counts.steps["instructions"].tolist() == STORED[solver, target]


@pytest.mark.parametrize("target", TARGETS)
def test_a_repetition_is_identical_to_the_bit(target: str) -> None:
    first, second = (
        tabulate_counted_steps([count("hildreth", target, load("move-30-5", 4))]) for _ in "12"
    )
    assert first.equals(second)
    assert (first["instructions"] > 1000).all()


@pytest.mark.parametrize("solver", ["daqp", "quadprog", "hildreth", "paper_active_set"])
@pytest.mark.parametrize("name", ["paper-30-5", SOFT])
def test_answers_equal_those_of_the_desk(solver: str, name: str) -> None:
    sequence = load(name, 6)
    counts = count(solver, "a53", sequence)
    policy = "reuse" if solver == "quadprog" else "warm"
    settings: Settings = HIGH if solver == "hildreth" else "default"
    desk = open_workspace(solver, route="native", policy=policy, settings=settings)
    desk.setup(sequence.base)
    for k in range(len(sequence)):
        desk.update(sequence.step(k))
        desk.solve()
        answer = desk.read()
        np.testing.assert_allclose(counts.z[k], answer.z, rtol=0, atol=1e-12)
        assert counts.steps["iterations"][k] == answer.iterations
    # Without refinement the paper's method claims no optimum where rounding decides.
    claims = {0, -4} if (solver, name) == ("paper_active_set", SOFT) else {0}
    assert set(counts.steps["status"].tolist()) <= claims
    assert counts.error_move.max() < 1e-2


@pytest.mark.parametrize("own", [{}, {"rho": 1.6, "eps_abs": 1e-5, "eps_rel": 1e-3}])
def test_answers_of_osqp_equal_those_of_its_wheel(own: dict[str, float]) -> None:
    sequence = load("move-30-5", 6)
    counts, qp = count("osqp", "a53", sequence, settings=own), sequence.base
    library = osqp.OSQP()
    rows = scipy.sparse.csc_matrix(np.vstack([qp.A, np.eye(qp.n)]))
    options = {"rho": 0.25, "eps_abs": 1e-6, "eps_rel": 0.0, "max_iter": 200000} | own
    limits = np.append(qp.l, qp.lb), np.append(qp.u, qp.ub)
    library.setup(
        scipy.sparse.csc_matrix(qp.P),
        np.zeros(qp.n),
        rows,
        *limits,
        verbose=False,
        **options,
        adaptive_rho=False,
    )
    for k in range(len(sequence)):
        low, high = np.append(sequence.l[k], qp.lb), np.append(sequence.u[k], qp.ub)
        library.update(q=sequence.q[k], l=low, u=high)
        answer = library.solve(raise_error=True)
        np.testing.assert_allclose(counts.z[k], answer.x, rtol=0, atol=1e-9)
        assert counts.steps["iterations"][k] == answer.info.iter


def test_qoco_meets_its_tolerance_with_rows_that_are_equalities() -> None:
    pytest.importorskip("qocogen", reason="the generator of QOCO's C is not installed")
    sequence = load("paper-30-5", 3)
    base, l, u = sequence.base, sequence.l.copy(), sequence.u.copy()  # noqa: E741 - the field `l` of QuadraticProgram
    # Half the way to the optimum is feasible.
    half = [0.5 * base.A[1] @ optimum.z for optimum in certify_all_steps(sequence)]
    l[:, 1] = u[:, 1] = half
    fixed = replace(sequence, base=replace(base, l=l[0], u=u[0]), l=l, u=u)
    counts = count("qoco", "a53", fixed)
    assert set(counts.steps["status"].tolist()) == {0}
    assert counts.error_plan.max() < 1e-2
    np.testing.assert_allclose(counts.z @ base.A[1], half, atol=1e-6)


@pytest.mark.parametrize(
    ("solver", "most", "heap"),
    [("qpoases", 1e-10, 50_000), ("piqp", 1e-5, 100_000), ("hpipm", 1e-5, 100_000)],
)
@pytest.mark.parametrize("name", ["paper-30-5", "turn-30-5"])
def test_further_solvers_repeat_their_counts(
    solver: str, most: float, heap: int, name: str
) -> None:
    first, second = (count(solver, "a53", load(name, 5)) for _ in "12")
    assert tabulate_counted_steps([first]).equals(tabulate_counted_steps([second]))
    assert set(first.steps["status"].tolist()) == {0}
    assert first.error_plan.max() < most
    # Memory that is given back is used again.
    assert 0 < first.sizes["heap"] < heap


def test_matrices_of_each_step_and_single_precision() -> None:
    changing = load("turn-30-5", 5)
    for solver in ("daqp", "paper_active_set", "quadprog"):
        assert count(solver, "a53", changing).error_plan.max() < 1e-11
    single = count("paper_active_set", "m7", load("move-30-5", 5), single=True)
    assert 1e-9 < single.error_plan.max() < 1e-3
    with pytest.raises(InputError, match=r"osqp: found P, which changes in turn-30-5"):
        count("osqp", "a53", changing)
    with pytest.raises(InputError, match=r"quadprog: --float: found single precision"):
        count("quadprog", "m7", load("move-30-5", 5), single=True)


def test_the_papers_method_claims_its_optima_if_refined() -> None:
    settings = {"refine": 1}
    refined = count("paper_active_set", "a53", load(SOFT, 6), settings=settings)
    assert refined.settings == settings
    assert (refined.steps["status"] == 0).all()
    assert refined.error_plan.max() < 1e-12


def test_table_and_summary(tmp_path: Path) -> None:
    counts = count("paper_active_set", "m7", load("paper-30-5", 5))
    table = tabulate_counted_steps([counts])
    assert (
        save_counted_steps_in_folder([counts], tmp_path / "out")
        == tmp_path / "out" / "embedded.parquet"
    )
    assert table["k"].tolist() == [0, 1, 2, 3, 4]
    assert set(table["heap_bytes"]) == {0}
    (summary,) = summarise_counted_runs(table)
    assert summary["instructions_max"] == table["instructions"].max()
    assert summary["instructions_p50"] == table["instructions"].median()
    assert 0 < summary["stack_bytes"] < 1000
