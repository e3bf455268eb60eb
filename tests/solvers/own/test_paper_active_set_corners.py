"""The paper's method at corners of polygons, with rows per move of their own, and with slacks."""

import numpy as np
import pytest

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.referee import Referee
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.constants import empty, fill
from dpbench.solvers.own.active_set.kernel import solve_step
from dpbench.solvers.own.paper_active_set import PaperActiveSet
from tests.solvers.conftest import solve_next, solve_qp

INF = np.inf


@pytest.fixture
def workspace(monkeypatch):
    """A warm workspace whose compiled method has to do without the safeguards."""

    def refuse(self, ending):
        raise AssertionError(f"left to the safeguards: ending {ending}")

    monkeypatch.setattr(PaperActiveSet, "_decide", refuse)
    return open_workspace("paper_active_set", policy="warm")


def azimuths(moves, thrust, sides=16):
    """P and rows of two azimuth thrusters with polygons around f + Σz, in largest steps."""
    angle = (2 * np.arange(sides // 2) + 1) * np.pi / sides
    normals = np.kron(np.eye(2), np.column_stack((np.cos(angle), np.sin(angle))))
    A = np.kron(np.tri(moves), normals)
    high = np.full(len(A), thrust * np.cos(np.pi / sides))
    force = np.array([[1.0, 0, 1, 0], [0, 1, 0, 1], [0.3, -1, -0.2, 1]])
    reach = np.kron(np.tri(moves), force)
    P = 0.1 * np.eye(4 * moves) + reach.T @ reach
    return P, A, high, reach, normals


@pytest.mark.slow
@pytest.mark.parametrize(("moves", "thrust"), [(3, 2), (5, 3), (6, 2)])
def test_a_corner_reached_at_the_largest_rate_is_solved_as_any_other_point(
    workspace, moves, thrust
):
    """More rows meet than there are dimensions, and no step is left to the safeguards."""
    P, A, high, reach, normals = azimuths(moves, thrust)
    one, f = np.ones(len(P)), np.zeros(4)
    base = QuadraticProgram(P, one, A, -high, high, -one, one)
    referee = Referee(P, A, base.lb, base.ub)
    workspace.setup(base)
    corners = 0
    for k in range(40):
        # Wanted: forces along the corners, first one way and then the other.
        wanted = 9.0 * thrust * np.array([np.cos(k // 8), np.sin(k // 16), 0.1 * (k % 3)])
        now = np.tile(normals @ f, moves)
        q = -reach.T @ np.tile(wanted if k % 8 else np.array([9.0 * thrust, 0, 0]), moves)
        step = QPStep(q, -high - now, high - now)
        answer, optimum = solve_next(workspace, step), referee.certify(step.q, step.l, step.u)
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, optimum.z, rtol=0, atol=1e-10)
        value = np.concatenate([A @ answer.z, answer.z])
        limit = np.concatenate([step.u, one]), np.concatenate([step.l, -one])
        met = (np.abs(value - limit[0]) < 1e-9) | (np.abs(value - limit[1]) < 1e-9)
        corners += np.count_nonzero(met) > np.linalg.matrix_rank(
            np.vstack([A, np.eye(len(P))])[met]
        )
        f = f + answer.z[:4]
    assert corners > 3


@pytest.mark.parametrize("left", [0, 1, 3])
def test_a_thruster_that_shrinks_at_its_rate_has_to_make_the_largest_steps(workspace, left):
    """Rows and bounds that leave one another no room, exactly, are equalities."""
    moves = 5
    A, one = np.tri(moves), np.ones(moves)
    # From 4 steps of thrust down to `left`, as fast as the rate allows.
    high = np.maximum(left, 4.0 - np.arange(1, moves + 1)) - 4.0
    qp = QuadraticProgram(np.eye(moves), -9 * one, A, np.full(moves, -8.0), high, -one, one)
    answer = solve_qp(workspace, qp)
    forced = np.diff(high, prepend=0.0)
    assert answer.status is Status.SOLVED
    np.testing.assert_array_equal(answer.z[: 4 - left], forced[: 4 - left])
    np.testing.assert_allclose(answer.z, forced, rtol=0, atol=1e-14)
    np.testing.assert_allclose(answer.z - 9 + A.T @ answer.y + answer.y_box, 0, atol=1e-13)


def test_rows_that_rounding_alone_sets_apart_are_doubtful():
    """Where a rounded limit may leave no point at all, the compiled method says so."""
    third, one = np.array([[1.0, 1 / 3, 1 / 7]]), np.ones(3)
    limit = third.sum(axis=1)
    qp = QuadraticProgram(np.eye(3), -3 * one, third, limit, [9.0], -one, one)
    S = empty(3, 1)
    assert fill(S, qp, keep=False) == ""
    assert solve_step(S) == layout.DOUBTFUL


def two_rows_a_move(moves):
    """One variable and two rows a move: z_i ≤ 9 and 2 z_i ≤ 1; the third move wants beyond it."""
    A, one = np.kron(np.eye(moves), [[1.0], [2.0]]), np.ones(moves)
    q = np.zeros(moves)
    q[2] = -3.0
    high = np.tile([9.0, 1.0], moves)
    return QuadraticProgram(np.eye(moves), q, A, -high, high, -9 * one, 9 * one, 1)


@pytest.mark.parametrize(("solver", "first"), [("paper_active_set", 1), ("hildreth", 2)])
def test_rows_move_on_by_the_rows_of_a_move(solver, first):
    """A row moves on by two places where a variable does by one: the kept set needs no change."""
    qp = two_rows_a_move(6)
    kept = open_workspace(solver, policy="warm")
    assert solve_qp(kept, qp).iterations == first
    answer = solve_next(kept, QPStep(np.roll(qp.q, -1), qp.l, qp.u))
    np.testing.assert_allclose(answer.z, [0, 0.5, 0, 0, 0, 0], rtol=0, atol=1e-15)
    assert answer.iterations == first - 1


def with_slacks(rng, moves, softened):
    """Moves with rows that slacks soften: most of P⁻¹ and of the rows is zero."""
    n, m = moves + softened, softened + moves
    B = rng.normal(size=(moves, moves))
    P = np.zeros((n, n))
    P[:moves, :moves] = B @ B.T + np.eye(moves)
    P[range(moves, n), range(moves, n)] = 1e-2
    A = np.zeros((m, n))
    A[:, :moves] = rng.normal(size=(m, moves))
    A[range(softened), range(moves, n)] = -1.0
    order = rng.permutation(n)
    q = np.concatenate([5.0 * rng.normal(size=moves), np.full(softened, 20.0)])
    lb = np.concatenate([np.full(moves, -1.0), np.zeros(softened)])
    ub = np.concatenate([np.full(moves, 1.0), np.full(softened, INF)])
    high = rng.uniform(0.1, 1.0, m)
    low = np.where(np.arange(m) < softened, -INF, -high)
    return QuadraticProgram(
        P[np.ix_(order, order)], q[order], A[:, order], low, high, lb[order], ub[order]
    )


@pytest.mark.parametrize(("moves", "softened"), [(3, 40), (10, 10), (20, 100)])
def test_softened_rows_give_the_certified_optimum(workspace, moves, softened):
    """Through steps whose slacks come and go every answer is the optimum."""
    rng = np.random.default_rng(softened)
    qp = with_slacks(rng, moves, softened)
    referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
    workspace.setup(qp)
    for _ in range(10):
        step = QPStep(qp.q * rng.uniform(0.5, 1.5, qp.n), qp.l, qp.u)
        answer, optimum = solve_next(workspace, step), referee.certify(step.q, step.l, step.u)
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, optimum.z, rtol=0, atol=1e-11)
