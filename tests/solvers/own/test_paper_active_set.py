"""The paper's active-set method on problems built from their optimum, and on infeasible ones."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.farkas import is_farkas_vector_proof
from dpbench.qp.referee.referee import Referee
from dpbench.qp.residuals import are_answers_correct, residuals
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import solve_next, solve_qp
from tests.solvers.own.random_costs import INF, cost, proves_infeasible, solve

RULES = {"deadline": None, "derandomize": True, "database": None}


def rows(rng, m, n):
    """Rows of any kind: general, or of −1, 0 and 1, with multiples of one another among them."""
    general = np.round(1024.0 * rng.normal(size=(m, n))) / 1024.0
    A = general if rng.random() < 0.5 else rng.integers(-1, 2, (m, n)) * 1.0
    if m > 3 and rng.random() < 0.7:
        A[1], A[2] = A[0], -2.0 * A[0]
    return A


def limits(rng, w, y):
    """Limits of which `w` with multipliers `y` is optimal: active, weakly active, equal, none."""
    low, high = w - rng.uniform(0, 3, w.size), w + rng.uniform(0, 3, w.size)
    low = np.where(rng.random(w.size) < 0.2, w, low)
    high = np.where(rng.random(w.size) < 0.2, w, high)
    low = np.where(rng.random(w.size) < 0.2, -INF, low)
    high = np.where(rng.random(w.size) < 0.2, INF, high)
    return np.where(y < 0, w, low), np.where(y > 0, w, high)


def from_optimum(seed):
    """A problem, the optimum it was built from, and its multipliers (which need not be unique)."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 12)), int(rng.integers(0, 20))
    P, A = cost(rng, n, 10.0 ** rng.uniform(0, 4)), rows(rng, m, n)
    z = rng.integers(-2, 3, n) * 1.0
    y = np.where(rng.random(m) < 0.4, rng.normal(size=m) * 10.0 ** rng.uniform(-1, 2), 0.0)
    y_box = np.where(rng.random(n) < 0.4, 10.0 * rng.normal(size=n), 0.0)
    l, u = limits(rng, A @ z, y)  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    lb, ub = limits(rng, z, y_box)
    q = -(P @ z + A.T @ y + y_box)
    return QuadraticProgram(P, q, A, l, u, lb, ub), z


@pytest.mark.slow
@settings(max_examples=400, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_it_finds_the_optimum_a_problem_was_built_from(seed):
    """Degenerate, weakly active, dependent, equal and infinite limits: the optimum is found."""
    qp, z = from_optimum(seed)
    answer = solve(qp)
    assert answer.status is Status.SOLVED
    # Forward error: the condition of P (1e4) times that of the active rows (1e4 in rare draws)
    # times rounding; z is of size one.
    np.testing.assert_allclose(answer.z, z, rtol=0, atol=1e-8)
    residual = qp.P @ answer.z + qp.q + qp.A.T @ answer.y + answer.y_box
    # What rounding in P⁻¹ leaves of a gradient of size one, for a condition of 1e4.
    assert np.abs(residual).max() <= 2e-12 * (1.0 + np.abs(qp.q).max())
    low, high, y = (
        np.concatenate(pair) for pair in ((qp.l, qp.lb), (qp.u, qp.ub), (answer.y, answer.y_box))
    )
    w = np.concatenate([qp.A @ answer.z, answer.z])
    # A multiplier names the limit its row sits at.
    assert np.abs((w - high)[y > 0]).max(initial=0.0) <= 1e-10
    assert np.abs((w - low)[y < 0]).max(initial=0.0) <= 1e-10


def contradiction(seed):
    """A problem whose limits contradict each other by a given amount, as a Farkas ray shows."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 10)), int(rng.integers(2, 20))
    P, A = cost(rng, n, 100.0), rows(rng, m, n)
    y = rng.normal(size=m) * (rng.random(m) < 0.5)
    y[0] = 1.0
    y_box = -(A.T @ y)
    z = rng.normal(size=n)
    w = A @ z
    u, l = np.where(y > 0, w, INF), np.where(y < 0, w, -INF)  # noqa: E741 - as above
    ub, lb = np.where(y_box > 0, z, INF), np.where(y_box < 0, z, -INF)
    # Σ u y⁺ − Σ l y⁻ + … is zero at w, z and falls by what row 0 is tightened.
    u[0] -= 10.0 ** rng.uniform(-5, 0)
    return QuadraticProgram(P, 10.0 * rng.normal(size=n), A, l, u, lb, ub)


@pytest.mark.slow
@settings(max_examples=300, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_infeasibility_comes_with_a_farkas_ray(seed):
    """Contradicting limits are found, and y, y_box prove the contradiction."""
    qp = contradiction(seed)
    answer = solve(qp)
    assert answer.status is Status.PRIMAL_INFEASIBLE
    assert np.isnan(answer.z).all()
    ray = np.concatenate([answer.y, answer.y_box])
    high, low = np.concatenate([qp.u, qp.ub]), np.concatenate([qp.l, qp.lb])
    combination = qp.A.T @ answer.y + answer.y_box
    # Rounding of a solve with dependent rows; the amount of the contradiction is 1e-5 or more.
    assert np.abs(combination).max() <= 1e-9 * np.abs(ray).max()
    assert (high[ray > 0] * ray[ray > 0]).sum() + (low[ray < 0] * ray[ray < 0]).sum() < 0.0


def test_crossed_limits_are_infeasible():
    """A lower limit above its upper one is reported without a search."""
    eye = np.eye(2)
    qp = QuadraticProgram(eye, [0, 0], eye, [0, 2], [1, 1], [-9, -9], [9, 9])
    answer = solve(qp)
    assert answer.status is Status.PRIMAL_INFEASIBLE
    assert answer.detail == "the limits of row 1 of [A; I] cross"
    assert is_farkas_vector_proof(qp, answer.y, answer.y_box)


def klee_minty(n):
    """The cube of Klee and Minty (1972) with its objective as a cost of vanishing curvature."""
    A = np.eye(n) + 2.0 * np.tril(4.0 ** np.maximum(np.subtract.outer(range(n), range(n)), 0), -1)
    u = 5.0 ** np.arange(1, n + 1)
    q = -(2.0 ** np.arange(n - 1, -1, -1))
    bounds = np.zeros(n), np.full(n, INF)
    return QuadraticProgram(1e-6 * np.eye(n), q, A, np.full(n, -INF), u, *bounds)


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_it_ends_on_the_klee_minty_cube(n):
    """On the cube that defeats the simplex method it ends at the known vertex (0, …, 0, 5ⁿ)."""
    answer, expected = solve(klee_minty(n)), 5.0**n * np.eye(n)[-1]
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z, expected, rtol=0, atol=1e-9 * 5.0**n)


def test_it_ends_on_beales_cycling_example():
    """On Beale's example, where the simplex method cycles, it ends at the known vertex."""
    A = np.array([[0.25, -8.0, -1.0, 9.0], [0.5, -12.0, -0.5, 3.0], [0.0, 0.0, 1.0, 0.0]])
    q = np.array([-0.75, 20.0, -0.5, 6.0])
    # The optimum (1, 0, 1, 0) of the linear programme stays one under a small curvature.
    bounds = np.zeros(4), np.full(4, INF)
    answer = solve(QuadraticProgram(1e-3 * np.eye(4), q, A, [-INF] * 3, [0, 0, 1], *bounds))
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z, [1, 0, 1, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("copies", [1, 5, 40])
def test_a_vertex_with_many_limits_is_no_obstacle(copies):
    """Any number of copies of the active rows leaves the answer as it is."""
    rng = np.random.default_rng(0)
    A = np.tile(np.eye(3), (copies, 1))
    m = 3 * copies
    qp = QuadraticProgram(
        cost(rng, 3, 10.0), [-50, -60, -70], A, -np.ones(m), np.ones(m), -np.ones(3), np.ones(3)
    )
    answer = solve(qp)
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z, np.ones(3), rtol=0, atol=1e-14)


@pytest.mark.parametrize("exponent", [-6, 0, 6])
def test_units_do_not_matter(exponent):
    """In other units of variables and rows the same active set gives the same answer."""
    qp, z = from_optimum(12345)
    rng = np.random.default_rng(1)
    span = sorted((0, exponent))
    s, r = 10.0 ** rng.uniform(*span, qp.n), 10.0 ** rng.uniform(*span, qp.m)
    P, A = qp.P * np.outer(s, s), (qp.A * s) * r[:, None]
    other = QuadraticProgram(P, qp.q * s, A, qp.l * r, qp.u * r, qp.lb / s, qp.ub / s)
    answer = solve(other)
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z * s, z, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("where", "value"),
    [(name, np.nan) for name in ("q", "l", "u", "lb", "ub", "P", "A")]
    + [(name, INF) for name in ("q", "P", "A")],
)
def test_data_that_are_no_numbers_end_at_once(where, value):
    """A NaN anywhere, or an infinite cost or row, gives ERROR, not an endless search."""
    qp, _ = from_optimum(12345)
    getattr(qp, where).flat[0] = value
    assert solve(qp).status is Status.ERROR


def test_a_cost_that_is_not_positive_definite_is_refused():
    """Eq. 31 needs P⁻¹: a P that is not positive definite gives ERROR with the reason."""
    eye = np.eye(2)
    qp = QuadraticProgram(np.diag([1.0, 0.0]), [1, 1], eye, [-1, -1], [1, 1], [-1, -1], [1, 1])
    answer = solve(qp)
    assert answer.status is Status.ERROR
    assert answer.detail == "P is not positive definite"


def test_kept_constants_change_nothing(sequence):
    """Policy `reuse` gives bit for bit what `fresh` gives."""
    answers = sequence.answers(open_workspace("paper_active_set", policy="reuse"))
    for step, answer in zip(sequence.steps, answers, strict=True):
        np.testing.assert_array_equal(answer.z, solve(sequence.base.at(step)).z)


def matrices(rng, n, m):
    """P with a condition up to 1e8, and rows of unit norm, some of them zero or written twice."""
    P = cost(rng, n)
    A = rng.normal(size=(m, n)) if rng.random() < 0.5 else rng.integers(-1, 2, (m, n)) * 1.0
    A = A * (rng.random((m, n)) < rng.uniform(0.1, 1))
    length = np.linalg.norm(A, axis=1)
    A /= np.where(length > 0.0, length, 1.0)[:, None]
    if m > 6 and rng.random() < 0.7:
        twice = int(rng.integers(1, m // 2))
        A[rng.integers(0, m, twice)] = A[rng.integers(0, m, twice)]
    return P, A


def parametric(rng, n, m):
    """A QP and five steps: equal, infinite and touching limits, costs far beyond them."""
    P, A = matrices(rng, n, m)
    z = rng.normal(size=n) * 10.0 ** rng.uniform(-1, 1)
    w = A @ z
    low, high = (w + side * rng.uniform(0, 1, m) * (rng.random(m) < 0.7) for side in (-1, 1))
    kind = rng.random(m)
    low = np.where(kind < 0.2, -INF, low)
    high = np.where((kind > 0.1) & (kind < 0.35), INF, high)
    lb, ub = (z + side * rng.uniform(0, 1, n) * (rng.random(n) < 0.8) for side in (-1, 1))
    lb, ub = np.where(rng.random(n) < 0.3, -INF, lb), np.where(rng.random(n) < 0.3, INF, ub)
    q = rng.normal(size=n) * 10.0 ** rng.uniform(-1, 3)
    base = QuadraticProgram(P, q, A, low, high, lb, ub)
    steps = []
    for _ in range(5):
        q = q + 0.1 * np.abs(q).max() * rng.normal(size=n)
        steps.append(QPStep(q, low - 0.05 * rng.random(m), high + 0.05 * rng.random(m)))
    return base, [QPStep(base.q, low, high), *steps]


@pytest.mark.slow
@settings(max_examples=120, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_what_it_calls_solved_the_referee_finds_true(seed):
    """On random sequences every claim holds against the certified optimum, or is not made."""
    rng = np.random.default_rng(seed)
    base, steps = parametric(rng, int(rng.integers(2, 13)), int(rng.integers(0, 20)))
    referee = Referee(base.P, base.A, base.lb, base.ub)
    solver = open_workspace("paper_active_set", policy="warm")
    solver.setup(base)
    for step in steps:
        answer, qp = solve_next(solver, step), base.at(step)
        optimum = referee.certify_vectors(qp.q, qp.l, qp.u)
        if not answer.claimed:
            # Limits through one point that rounding has moved apart: infeasible.
            assert optimum.kind != "linear"
            solver.reset()
            continue
        found, size = residuals(qp, answer), 1.0 + np.abs(answer.z).max()
        # A thousand times rounding: limits and rows are of the size of z.
        assert found.primal <= 1e-12 * size
        if np.isfinite(optimum.bound):
            error = np.abs(answer.z - optimum.z).max()
            # Rounding is 1e-16, times a condition of 1e8, of what may be 1e5 times a plan in size.
            assert are_answers_correct(qp.q[np.newaxis], found, error / size, 1e-6)


@pytest.mark.slow
@settings(max_examples=15, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_larger_sequences_satisfy_the_optimality_conditions(seed):
    """Up to 120 variables and 300 rows every answer satisfies the KKT conditions.

    The limits of the first step meet in a point but for rounding, where nothing has to be claimed.
    """
    rng = np.random.default_rng(seed)
    base, steps = parametric(rng, int(rng.integers(20, 121)), int(rng.integers(0, 301)))
    solver = open_workspace("paper_active_set", policy="warm")
    solver.setup(base)
    for k, step in enumerate(steps):
        answer, qp = solve_next(solver, step), base.at(step)
        assert answer.claimed or (k == 0 and answer.status is Status.INACCURATE)
        found, size = residuals(qp, answer), 1.0 + np.abs(answer.z).max()
        # A thousand times rounding of the terms each residual is a sum of.
        assert found.primal <= 1e-12 * size
        terms = np.abs(qp.q).max() + np.abs(qp.P).max() * size + np.abs(answer.y).max(initial=0.0)
        assert found.dual <= 1e-12 * terms
        assert found.complementarity <= 1e-12 * terms * size


@settings(max_examples=60, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_between_finite_limits_the_proof_of_infeasibility_is_exact(seed):
    """Within a finite box y alone proves the contradiction, and the referee decides it exactly."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 30)), int(rng.integers(2, 40))
    P, A = matrices(rng, n, m)
    j = int(rng.integers(0, m))
    A[j] = rng.normal(size=n)
    low, high = -rng.uniform(0, 1, m), rng.uniform(0, 1, m)
    # No z within ±1 has a row value beyond the sum of the row's entries.
    low[j] = np.abs(A[j]).sum() * (1.0 + 10.0 ** rng.uniform(-6, 0))
    high[j] = low[j] + 1.0
    qp = QuadraticProgram(P, 100 * rng.normal(size=n), A, low, high, -np.ones(n), np.ones(n))
    solver = open_workspace("paper_active_set", policy="warm")
    answer = solve_qp(solver, qp)
    assert answer.status is Status.PRIMAL_INFEASIBLE
    assert is_farkas_vector_proof(qp, answer.y, answer.y_box)
    assert proves_infeasible(qp, answer.y, answer.y_box)


def test_a_ray_that_proves_nothing_is_no_proof():
    """A vector that does not cancel, or whose limits leave room, proves nothing."""
    one = np.ones(1)
    qp = QuadraticProgram(np.eye(1), one, [[1.0]], [2.0], [3.0], [-1.0], [1.0])
    assert proves_infeasible(qp, -one, one)
    assert not proves_infeasible(qp, -one, 0.5 * one)
    assert not proves_infeasible(qp, one, -one)
