"""Rows of A that change from step to step, and rows with equal limits: the same answers as of a
workspace that knows nothing of the step before."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.bench.sequences.sequence_file import load_sequence
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Status
from dpbench.solvers.contract import Policy
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.paper_active_set import PaperActiveSet
from tests.solvers.conftest import solve_next, solve_qp

POLICIES: tuple[Policy, ...] = ("fresh", "reuse", "warm")


def problem(rng: np.random.Generator, n: int, m: int) -> QuadraticProgram:
    """A feasible problem (z = 0 satisfies it) with rows of two entries each."""
    root = rng.normal(size=(n, n))
    one = np.ones(n)
    low, high = -rng.uniform(0.0, 0.5, m), rng.uniform(0.0, 0.5, m)
    P, q = root @ root.T + 0.1 * np.eye(n), 3.0 * rng.normal(size=n)
    return QuadraticProgram(P, q, rows_of_two(rng, n, m), low, high, -one, one)


def rows_of_two(rng: np.random.Generator, n: int, m: int) -> np.ndarray:
    A = np.zeros((m, n))
    for i in range(m):
        A[i, rng.choice(n, 2, replace=False)] = rng.normal(size=2)
    return A


def opened(policy: Policy = "warm") -> PaperActiveSet:
    workspace = open_workspace("paper_active_set", route="native", policy=policy)
    assert isinstance(workspace, PaperActiveSet)
    return workspace


@pytest.mark.parametrize("policy", POLICIES)
def test_answers_on_rows_that_change_are_those_of_a_new_workspace(policy: Policy) -> None:
    """Some of the rows, then all of them, then none, then dense ones, which are set up anew."""
    rng = np.random.default_rng(4)
    qp = problem(rng, 12, 30)
    workspace = opened(policy)
    workspace.setup(qp)
    A, updates = qp.A, 0
    for k in range(40):
        A = A.copy()
        if k % 4 == 3:
            A[:] = rng.normal(size=A.shape)
        elif k % 4 != 2:
            which = rng.choice(30, 6 if k % 4 == 0 else 30, replace=False)
            A[which] = rows_of_two(rng, 12, 30)[which]
        step = QPStep(rng.normal(size=12) * 3.0, qp.l, qp.u, A=A)
        workspace.update(step)
        updates += 1
        workspace.solve()
        answer = workspace.read()
        alone = opened("reuse")
        alone.setup(qp.at(step))
        alone.solve()
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, alone.read().z, atol=1e-9)
    assert workspace.matrix_updates == updates


def test_vectors_alone_then_go_with_the_rows_that_came_last() -> None:
    """Also where the problem as a whole is asked for, as behind a contradiction."""
    one = np.ones(2)
    qp = QuadraticProgram(np.eye(2), -2 * one, np.eye(2), -9 * one, 9 * one, -one, one)
    workspace = opened()
    workspace.setup(qp)
    workspace.update(
        QPStep(-2 * one, -9 * one, np.array([0.5, 9.0]), A=np.array([[1.0, 1], [0, 1]]))
    )
    np.testing.assert_allclose(
        solve_next(workspace, QPStep(-2 * one, -9 * one, np.array([1.0, 9.0]))).z,
        [0.5, 0.5],
        atol=1e-12,
    )
    low = np.array([2.5, -9.0])
    answer = solve_next(workspace, QPStep(-2 * one, low, np.array([9.0, 9.0])))
    assert answer.status is Status.PRIMAL_INFEASIBLE
    np.testing.assert_allclose(answer.y_box, -answer.y @ [[1.0, 1.0], [0.0, 1.0]])
    assert 2 * answer.y_box.max() + 2.5 * answer.y[0] < 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_rows_that_are_no_numbers_are_refused_and_the_next_ones_are_not(value: float) -> None:
    rng = np.random.default_rng(1)
    qp = problem(rng, 4, 6)
    workspace = opened()
    workspace.setup(qp)
    bad = qp.A.copy()
    bad[2, 1] = value
    assert solve_next(workspace, QPStep(qp.q, qp.l, qp.u, A=bad)).status is Status.ERROR
    assert solve_next(workspace, QPStep(qp.q, qp.l, qp.u, A=qp.A)).status is Status.SOLVED


def test_the_set_goes_on_from_step_to_step_though_all_of_them_bring_rows() -> None:
    """Far fewer iterations than from nothing, and the same answers, on a shipped sequence."""
    sequence = load_sequence("thrusters_turning-30-5")
    count: dict[Policy, int] = {}
    for policy in POLICIES[1:]:
        workspace = opened(policy)
        workspace.setup(sequence.base)
        count[policy] = 0
        for k in range(1, len(sequence)):
            answer = solve_next(workspace, sequence.step(k))
            assert answer.status is Status.SOLVED
            count[policy] += answer.iterations
    assert count["warm"] < 0.5 * count["reuse"]


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(0, 6), st.booleans())
def test_rows_with_equal_limits_are_active_from_the_start(
    seed: int, n: int, equal: int, at_rest: bool
) -> None:
    """No iteration brings them in; one that depends on others is left out; z = 0 is no doubt."""
    rng = np.random.default_rng(seed)
    m = n + 4
    qp = problem(rng, n, m)
    low, high = qp.l.copy(), qp.u.copy()
    A = rng.normal(size=(m, n))
    which = rng.choice(m, min(equal, n - 1), replace=False)
    low[which] = high[which] = 0.0
    A[-1], low[-1], high[-1] = 2.0 * A[0], 2.0 * low[0], 2.0 * high[0]
    q = np.zeros(n) if at_rest else qp.q
    posed = QuadraticProgram(qp.P, q, A, low, high, qp.lb, qp.ub)
    workspace = opened()
    answer = solve_qp(workspace, posed)
    assert answer.status is Status.SOLVED
    left = residuals(posed, answer)
    assert left.primal <= 1e-9 and left.dual <= 1e-9 * (1.0 + np.abs(q).max())
    if at_rest:
        assert answer.iterations == 0
        np.testing.assert_array_equal(answer.z, np.zeros(n))
