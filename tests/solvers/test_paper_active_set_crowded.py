"""The paper's method where rounding decides: near copies of rows, dependent rows, far points."""

from __future__ import annotations

import numpy as np
import pytest

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from dpbench.solvers.pinned import determined
from dpbench.solvers.proof import contradicts

INF = np.inf


def solve(qp):
    workspace = open_workspace("paper_active_set")
    workspace.setup(qp)
    workspace.solve()
    return workspace.read()


def crowded(seed):
    """A vertex with more limits than variables, of rows that are combinations and near copies."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 20)), int(rng.integers(8, 60))
    k = m // 3
    A = rng.normal(size=(m, n))
    A[:k] = rng.integers(-2, 3, (k, m - k)) @ A[k:] * (rng.random((k, 1)) < 0.5) + A[k : 2 * k]
    copies = A[rng.integers(0, m, k)]
    A[k : 2 * k] = copies + 10.0 ** rng.uniform(-13, -6) * rng.normal(size=(k, n))
    A /= np.linalg.norm(A, axis=1)[:, None]
    z = rng.normal(size=n)
    w, width = A @ z, 10.0 ** rng.choice([-9.0, -3.0, 0.0])
    low = w - width * rng.random(m) * (rng.random(m) < 0.5)
    high = w + width * rng.random(m) * (rng.random(m) < 0.5)
    q = 10.0 ** rng.uniform(-1, 4) * rng.normal(size=n)
    lb, ub = np.where(rng.random((2, n)) < 0.5, [[-INF], [INF]], [z - 1, z + 1])
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * np.geomspace(1.0, 10.0 ** rng.uniform(0, 8), n)) @ Q.T
    return QuadraticProgram(0.5 * (P + P.T), q, A, low, high, lb, ub)


def assert_true_to_rounding(qp, answer):
    """The optimality conditions in the problem's own data, as a claim to have solved it asserts."""
    found, size = residuals(qp, answer), 1.0 + np.abs(answer.z).max()
    # Rounding of row values is 1e-16 of z; an unchecked answer misses by 1e-9 and far more.
    assert found.primal <= 1e-12 * size
    # Multipliers of up to 1e9, which near copies of rows make, have a rounding of 1e-7.
    assert found.dual <= 1e-6 * (1.0 + np.abs(qp.q).max())


# Found by a search: called solved with gradients of up to 1e16 and rows violated by up to 1e5,
# before answers were checked.
@pytest.mark.parametrize("seed", [5, 24, 404, 436, 832, 934, 1049, 1410, 1462, 1713])
def test_what_was_once_wrongly_called_solved_is_no_more(seed):
    """Near copies of rows at a crowded vertex: solved is claimed where it is true, or not at all.

    An answer that is not claimed still satisfies the limits to what sets near copies apart.
    """
    qp = crowded(seed)
    answer = solve(qp)
    if answer.claimed:
        assert_true_to_rounding(qp, answer)
    else:
        assert answer.status is Status.INACCURATE
        assert residuals(qp, answer).primal <= 1e-8 * (1.0 + np.abs(answer.z).max())


def test_crowded_vertices_are_solved_or_not_claimed():
    """Of 200 random crowded vertices, all feasible, none is called infeasible, most are solved."""
    claimed = 0
    for seed in range(200):
        qp = crowded(seed)
        answer = solve(qp)
        assert answer.status is not Status.PRIMAL_INFEASIBLE
        if answer.claimed:
            claimed += 1
            assert_true_to_rounding(qp, answer)
    # Two in three are; in the rest a violated near copy is left, or multipliers beyond 1e9.
    assert claimed >= 100


def test_a_long_way_to_a_vertex_loses_nothing():
    """A cost that pulls 1e7 beyond the limits leaves no trace in the vertex it ends at."""
    for seed in range(50):
        rng = np.random.default_rng(seed)
        n, m = int(rng.integers(2, 8)), 12
        A = rng.normal(size=(m, n))
        A /= np.linalg.norm(A, axis=1)[:, None]
        z, y = rng.integers(-2, 3, n) * 0.5, np.zeros(m)
        y[:n] = 10.0 ** rng.uniform(6, 8, n)
        high = A @ z + np.where(y > 0.0, 0.0, rng.uniform(1e-6, 1.0, m))
        P = np.diag(np.geomspace(1.0, 1e5, n))
        none = np.full(n, INF)
        qp = QuadraticProgram(P, -(P @ z + A.T @ y), A, np.full(m, -INF), high, -none, none)
        answer = solve(qp)
        assert answer.status is Status.SOLVED
        # Rounding times the condition of the rows, which is 1e4 at most in these draws.
        np.testing.assert_allclose(answer.z, z, rtol=0, atol=1e-11)


@pytest.mark.parametrize("distance", [1e2, 1e4])
def test_a_feasible_point_far_off_is_not_called_infeasible(distance):
    """Two rows at an angle so small that they meet far off contradict each other only nearby."""
    angle = 1e-9 / distance
    # z0 ≤ 1 and z0 + angle·z1 ≥ 1 + 1e-9 meet in (1, distance).
    A, none = np.array([[1.0, 0.0], [1.0, angle]]), np.full(2, INF)
    qp = QuadraticProgram(np.eye(2), [1, 1], A, [-INF, 1 + 1e-9], [1.0, INF], -none, none)
    ray = np.array([1.0, -1.0])
    assert not contradicts(qp, ray, -(A.T @ ray))
    assert solve(qp).status is not Status.PRIMAL_INFEASIBLE
    # Within a box that keeps z1 from going there they do.
    boxed = QuadraticProgram(
        np.eye(2), [1, 1], A, [-INF, 1 + 1e-9], [1.0, INF], [-9, -9], [9, 0.1 * distance]
    )
    assert contradicts(boxed, ray, -(A.T @ ray))


def pinned(seed, combine):
    """Five variables, three rows with equal limits and a fourth that follows from them."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(4, 5))
    A[3] = combine(A)
    z = rng.normal(size=5)
    w, none = A @ z, np.full(5, INF)
    w[3] = combine(w)
    return QuadraticProgram(np.diag([1.0, 2, 3, 4, 5]), rng.normal(size=5), A, w, w, -none, none)


@pytest.mark.parametrize("combine", [lambda a: a[0], lambda a: -2.0 * a[1]])
def test_copies_of_rows_with_equal_limits_change_nothing(combine):
    """A row with equal limits written twice, or a multiple of it, leaves the optimum as it is."""
    for seed in range(20):
        qp = pinned(seed, combine)
        answer = solve(qp)
        assert answer.status is Status.SOLVED
        P, A = qp.P, qp.A[:3]
        K = np.block([[P, A.T], [A, np.zeros((3, 3))]])
        expected = np.linalg.solve(K, np.concatenate([-qp.q, qp.l[:3]]))[:5]
        # Rounding times the condition of the three rows, 1e3 at most.
        np.testing.assert_allclose(answer.z, expected, rtol=0, atol=1e-12)


def test_rows_with_equal_limits_that_rounding_sets_apart_are_not_called_solved():
    """Where rounding alone decides in which point rows with equal limits meet, none is claimed."""
    for seed in range(20):
        qp = pinned(seed, lambda a: 0.3 * a[0] + 0.7 * a[1])
        answer = solve(qp)
        # Taken for exact, the four rows meet in another line than three of them, or not at all.
        assert answer.status is Status.INACCURATE
        assert residuals(qp, answer).primal <= 1e-14 * (1.0 + np.abs(answer.z).max())


def test_redundancy_is_decided_to_the_last_bit():
    """Sums of whole rows are redundant; sums that were rounded are not."""
    rng = np.random.default_rng(0)
    none = np.full(6, INF)
    for _ in range(20):
        whole = rng.integers(-3, 4, (4, 6)) * 1.0
        rounded = rng.normal(size=(4, 6))
        for A, redundant in ((whole, True), (rounded, False)):
            A[3] = A[0] - 3.0 * A[1] if redundant else A[0] / 3.0 + A[1] / 7.0
            w = np.zeros(4)
            qp = QuadraticProgram(np.eye(6), np.ones(6), A, w, w, -none, none)
            assert determined(qp) is redundant
