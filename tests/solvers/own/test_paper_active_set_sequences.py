"""The paper's method from step to step: starts, rows that change, corners of polygons, slacks."""

from fractions import Fraction

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings, strategies as st

from dpbench import load_scenario, run_closed_loop
from dpbench.bench.run.exact_loop import rebuild_sequence, solve_loop_exactly
from dpbench.bench.sequences.sequence_file import load_sequence
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.referee import Referee
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import Sequence, solve_next, solve_qp
from tests.solvers.own.random_costs import INF, solve, unlimited

POLICIES = ("fresh", "reuse", "warm")


def opened(policy="warm", solver="paper_active_set"):
    return open_workspace(solver, route="native", policy=policy)


def answers(workspace, sequence):
    """Return the answers along a recorded sequence."""
    return Sequence(sequence.base, map(sequence.step, range(len(sequence)))).answers(workspace)


@pytest.mark.slow
def test_in_newtons_every_step_is_claimed_too():
    """In SI units, where a plan is 1e5 and its rounding 1e-11 of that, no claim is lost."""
    scenario = load_scenario("paper").truncate(100)
    for policy in ("fresh", "warm"):
        steps = run_closed_loop(scenario, opened(policy), units="si").steps
        assert (steps["status"] == "SOLVED").all()
        assert steps["error_plan"].max() <= 1e-9


@pytest.mark.parametrize("name", ["paper", "paper_tight", "calm", "rough"])
def test_every_step_of_a_scenario_is_the_certified_optimum(name):
    """Along the reference loop every answer is the optimum to 1e-9 of the maximum increment."""
    scenario = load_scenario(name)
    exact = solve_loop_exactly(scenario)
    count = {}
    for policy in POLICIES[1:]:
        found = answers(opened(policy), rebuild_sequence(scenario, exact))
        assert all(answer.status is Status.SOLVED for answer in found)
        assert max(np.abs(a.z - z).max() for a, z in zip(found, exact.z, strict=True)) <= 1e-9
        count[policy] = sum(answer.iterations for answer in found)
    # What a start is for: the set changes in few steps, by few rows.
    assert count["warm"] <= 0.15 * count["reuse"]


def test_the_set_goes_on_from_step_to_step_though_all_of_them_bring_rows():
    """Far fewer iterations than from nothing, and the same answers, on a shipped sequence."""
    sequence, count = load_sequence("thrusters_turning-30-5"), {}
    for policy in POLICIES[1:]:
        found = answers(opened(policy), sequence)
        assert all(answer.status is Status.SOLVED for answer in found)
        count[policy] = sum(answer.iterations for answer in found[1:])
    assert count["warm"] < 0.5 * count["reuse"]


def chain(block, rows=((),)):
    """Six moves of one variable and some rows each, of which the third wants beyond its limit."""
    six, A = np.ones(6), np.kron(np.eye(6), np.reshape(rows, (-1, 1)))
    q = np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    bound = 9.0 if len(A) else 1.0
    high = np.tile([9.0, 1.0], 6)[: len(A)]
    return QuadraticProgram(np.eye(6), q, A, -high, high, -bound * six, bound * six, block)


@pytest.mark.parametrize(
    ("solver", "qp", "first", "then"),
    [
        ("paper_active_set", chain(1), 1, 2),
        ("hildreth", chain(1, [1.0, 2.0]), 2, 1),
    ],
)
def test_the_start_of_the_step_after(solver, qp, first, then):
    """A set one move nearer costs a drop and an add; the multipliers of Hildreth move on."""
    workspace = opened(solver=solver)
    assert solve_qp(workspace, qp).iterations == first
    answer = solve_next(workspace, QPStep(np.roll(qp.q, -1), qp.l, qp.u))
    expected = [0, 0.5 if qp.m else 1, 0, 0, 0, 0]
    np.testing.assert_allclose(answer.z, expected, rtol=0, atol=1e-15)
    assert answer.iterations == then


def test_the_same_set_costs_no_iteration():
    """A set that is still optimal is kept as it is, whatever the block."""
    qp = chain(1)
    solver = opened()
    assert solve_qp(solver, qp).iterations == 1
    assert solve_next(solver, QPStep(1.1 * qp.q, qp.l, qp.u)).iterations == 0
    solver.reset()
    solver.solve()
    assert solver.read().iterations == 1


@pytest.mark.parametrize("angle", [1e-3, 1e-5, 1e-8])
def test_nearly_parallel_rows_are_told_apart(angle):
    """Two rows at a small angle meet in one point, which is the optimum."""
    A = np.array([[1.0, 0.0], [1.0, angle]])
    # z0 ≤ 1 and z0 + angle·z1 ≤ 1 − angle meet in (1, −1); the cost pulls between the two rows.
    high = np.array([1.0, 1.0 - angle])
    z, y = np.array([1.0, -1.0]), np.array([2.0, 3.0])
    answer = solve(unlimited(np.eye(2), -(z + A.T @ y), A, [-INF, -INF], high))
    assert answer.status is Status.SOLVED
    # The rounding of `high` alone moves the point by 1e-16 over the angle.
    np.testing.assert_allclose(answer.z, z, rtol=0, atol=1e-15 / angle)


def odd(array, kind):
    """The same numbers in another kind of array."""
    if kind == "strided":
        return np.repeat(array, 2)[::2]
    if kind == "read-only":
        array = array.copy()
        array.flags.writeable = False
        return array
    return array.astype(kind)


@pytest.mark.parametrize("kind", ["strided", "read-only", ">f8", "float32"])
def test_other_kinds_of_arrays_are_taken_over_all_the_same(sequence, kind):
    """The compiled copy is for contiguous float64 arrays; others give the same answers."""
    vectors = [[a.astype("f4").astype(float) for a in (s.q, s.l, s.u)] for s in sequence.steps]
    usual = [QPStep(*arrays) for arrays in vectors]
    unusual = [QPStep(*(odd(array, kind) for array in arrays)) for arrays in vectors]
    pairs = (sequence._replace(steps=steps).answers(opened()) for steps in (usual, unusual))
    for expected, found in zip(*pairs, strict=True):
        np.testing.assert_array_equal(found.z, expected.z)


@pytest.mark.slow
def test_three_hundred_variables_and_six_hundred_rows():
    """With a box, 600 rows and some 200 of them active it agrees with quadprog."""
    rng = np.random.default_rng(0)
    n, m = 300, 600
    B = rng.normal(size=(n, n))
    P, A = B @ B.T / n + 0.1 * np.eye(n), rng.normal(size=(m, n)) / np.sqrt(n)
    q, two, one = 10 * rng.normal(size=n), 2 * np.ones(m), np.ones(n)
    solver = opened()
    solver.setup(QuadraticProgram(P, q, A, -two, two, -one, one))
    C = np.vstack([A, -A, np.eye(n), -np.eye(n)]).T
    limit = -np.concatenate([two, two, one, one])
    for _ in range(2):
        solver.solve()
        answer = solver.read()
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(
            answer.z, quadprog.solve_qp(P, -q, C, limit)[0], rtol=0, atol=1e-10
        )
        assert np.count_nonzero(answer.y) + np.count_nonzero(answer.y_box) > 150
        q = q + 0.1 * rng.normal(size=n)
        solver.update(QPStep(q, -two, two))


def problem(rng, n, m):
    """A feasible problem (z = 0 satisfies it) with rows of two entries each."""
    root = rng.normal(size=(n, n))
    one = np.ones(n)
    low, high = -rng.uniform(0.0, 0.5, m), rng.uniform(0.0, 0.5, m)
    P, q = root @ root.T + 0.1 * np.eye(n), 3.0 * rng.normal(size=n)
    return QuadraticProgram(P, q, rows_of_two(rng, n, m), low, high, -one, one)


def rows_of_two(rng, n, m):
    A = np.zeros((m, n))
    for i in range(m):
        A[i, rng.choice(n, 2, replace=False)] = rng.normal(size=2)
    return A


@pytest.mark.parametrize("policy", POLICIES)
def test_answers_on_rows_that_change_are_those_of_a_new_workspace(policy):
    """Some of the rows, then all of them, then none, then dense ones, which are set up anew."""
    rng = np.random.default_rng(4)
    qp = problem(rng, 12, 30)
    workspace = opened(policy)
    workspace.setup(qp)
    A = qp.A
    for k in range(40):
        A = A.copy()
        if k % 4 == 3:
            A[:] = rng.normal(size=A.shape)
        elif k % 4 != 2:
            which = rng.choice(30, 6 if k % 4 == 0 else 30, replace=False)
            A[which] = rows_of_two(rng, 12, 30)[which]
        step = QPStep(rng.normal(size=12) * 3.0, qp.l, qp.u, A=A)
        answer = solve_next(workspace, step)
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, solve(qp.at(step)).z, atol=1e-9)
    assert workspace.matrix_updates == 40


def test_vectors_alone_then_go_with_the_rows_that_came_last():
    """Also where the problem as a whole is asked for, as behind a contradiction."""
    one = np.ones(2)
    qp = QuadraticProgram(np.eye(2), -2 * one, np.eye(2), -9 * one, 9 * one, -one, one)
    workspace = opened()
    workspace.setup(qp)
    rows = np.array([[1.0, 1.0], [0.0, 1.0]])
    workspace.update(QPStep(-2 * one, -9 * one, np.array([0.5, 9.0]), A=rows))
    answer = solve_next(workspace, QPStep(-2 * one, -9 * one, np.array([1.0, 9.0])))
    np.testing.assert_allclose(answer.z, [0.5, 0.5], atol=1e-12)
    low = np.array([2.5, -9.0])
    answer = solve_next(workspace, QPStep(-2 * one, low, np.array([9.0, 9.0])))
    assert answer.status is Status.PRIMAL_INFEASIBLE
    np.testing.assert_allclose(answer.y_box, -answer.y @ rows)
    assert 2 * answer.y_box.max() + 2.5 * answer.y[0] < 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_rows_that_are_no_numbers_are_refused_and_the_next_ones_are_not(value):
    rng = np.random.default_rng(1)
    qp = problem(rng, 4, 6)
    workspace = opened()
    workspace.setup(qp)
    bad = qp.A.copy()
    bad[2, 1] = value
    assert solve_next(workspace, QPStep(qp.q, qp.l, qp.u, A=bad)).status is Status.ERROR
    assert solve_next(workspace, QPStep(qp.q, qp.l, qp.u, A=qp.A)).status is Status.SOLVED


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(0, 6), st.booleans())
def test_rows_with_equal_limits_are_active_from_the_start(seed, n, equal, at_rest):
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
    answer = solve(posed, policy="warm")
    assert answer.status is Status.SOLVED
    left = residuals(posed, answer)
    assert left.primal <= 1e-9 and left.dual <= 1e-9 * (1.0 + np.abs(q).max())
    if at_rest:
        assert answer.iterations == 0
        np.testing.assert_array_equal(answer.z, np.zeros(n))


@pytest.fixture
def workspace():
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
        answer, optimum = (
            solve_next(workspace, step),
            referee.certify_vectors(step.q, step.l, step.u),
        )
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


def test_a_point_that_rounding_alone_grants_or_denies_is_decided_exactly():
    """Three bounds and a row leave (1, 1, 1) or, one unit of rounding higher, no point at all."""
    third, one = np.array([[1.0, 1 / 3, 1 / 7]]), np.ones(3)
    limit = third.sum(axis=1)
    assert sum(map(Fraction, third[0])) >= Fraction(limit[0])
    for low, status in ((limit, Status.SOLVED), (np.nextafter(limit, 9.0), Status.INACCURATE)):
        answer = solve(QuadraticProgram(np.eye(3), -3 * one, third, low, [9.0], -one, one))
        assert answer.status is status
        np.testing.assert_allclose(answer.z, one, rtol=0, atol=1e-15)


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
        answer, optimum = (
            solve_next(workspace, step),
            referee.certify_vectors(step.q, step.l, step.u),
        )
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, optimum.z, rtol=0, atol=1e-11)
