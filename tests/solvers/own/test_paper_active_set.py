"""The paper's active-set method on problems built from their optimum, and on infeasible ones."""

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.feasibility.farkas import farkas_valid
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import solve_qp

INF = np.inf


def solve(qp):
    workspace = open_workspace("paper_active_set")
    return solve_qp(workspace, qp)


def cost(rng, n, condition):
    """A symmetric P with eigenvalues from 1 to `condition`."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * np.geomspace(1.0, condition, n)) @ Q.T
    return 0.5 * (P + P.T)


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
@settings(max_examples=400, deadline=None, derandomize=True, database=None)
@given(st.integers(0, 2**32 - 1))
def test_it_finds_the_optimum_a_problem_was_built_from(seed):
    """Degenerate, weakly active, dependent, equal and infinite limits: the optimum is found."""
    qp, z = from_optimum(seed)
    answer = solve(qp)
    assert answer.status is Status.SOLVED
    # Forward error: the condition of P (1e4) times that of the active rows (1e4 in rare draws)
    # times rounding; z is of size one.
    np.testing.assert_allclose(answer.z, z, rtol=0, atol=1e-8)
    scale = 1.0 + np.abs(qp.q).max()
    residual = qp.P @ answer.z + qp.q + qp.A.T @ answer.y + answer.y_box
    # Without refinement on the final set this is 1e-12 and grows with the condition of P.
    assert np.abs(residual).max() <= 2e-14 * scale
    low, high, y = (
        np.concatenate(pair) for pair in ((qp.l, qp.lb), (qp.u, qp.ub), (answer.y, answer.y_box))
    )
    w = np.concatenate([qp.A @ answer.z, answer.z])
    # A multiplier names the limit its row sits at.
    assert np.abs((w - high)[y > 0]).max(initial=0.0) <= 1e-10
    assert np.abs((w - low)[y < 0]).max(initial=0.0) <= 1e-10


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(st.integers(0, 2**32 - 1))
def test_it_agrees_with_quadprog(seed):
    """On problems with all limits finite it agrees with an independent implementation in C."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 16)), int(rng.integers(1, 16))
    P, A = cost(rng, n, 1e3), rng.normal(size=(m, n))
    q = 10.0 ** rng.uniform(-1, 3) * rng.normal(size=n)
    low, high = -rng.uniform(0.1, 2, m), rng.uniform(0.1, 2, m)
    qp = QuadraticProgram(P, q, A, low, high, -np.ones(n), np.ones(n))
    C = np.vstack([A, -A, np.eye(n), -np.eye(n)]).T
    limit = np.concatenate([low, -high, -np.ones(2 * n)])
    expected = quadprog.solve_qp(P, -q, C, limit)[0]
    np.testing.assert_allclose(solve(qp).z, expected, rtol=0, atol=1e-9)


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
@settings(max_examples=300, deadline=None, derandomize=True, database=None)
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
    assert farkas_valid(qp, answer.y, answer.y_box)


def klee_minty(n):
    """The cube of Klee and Minty (1972) with its objective as a cost of vanishing curvature."""
    A = np.eye(n) + 2.0 * np.tril(4.0 ** np.maximum(np.subtract.outer(range(n), range(n)), 0), -1)
    u = 5.0 ** np.arange(1, n + 1)
    q = -(2.0 ** np.arange(n - 1, -1, -1))
    return QuadraticProgram(
        1e-6 * np.eye(n), q, A, np.full(n, -INF), u, np.zeros(n), np.full(n, INF)
    )


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_it_ends_on_the_klee_minty_cube(n):
    """On the cube that defeats the simplex method it ends at the known vertex (0, …, 0, 5ⁿ)."""
    qp = klee_minty(n)
    answer = solve(qp)
    expected = np.zeros(n)
    expected[-1] = 5.0**n
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z, expected, rtol=0, atol=1e-9 * 5.0**n)


def test_it_ends_on_beales_cycling_example():
    """On Beale's example, where the simplex method cycles, it ends at the known vertex."""
    A = np.array([[0.25, -8.0, -1.0, 9.0], [0.5, -12.0, -0.5, 3.0], [0.0, 0.0, 1.0, 0.0]])
    q = np.array([-0.75, 20.0, -0.5, 6.0])
    # The optimum (1, 0, 1, 0) of the linear programme stays one under a small curvature.
    qp = QuadraticProgram(
        1e-3 * np.eye(4), q, A, np.full(3, -INF), [0, 0, 1], np.zeros(4), np.full(4, INF)
    )
    answer = solve(qp)
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
    other = QuadraticProgram(
        qp.P * np.outer(s, s),
        qp.q * s,
        (qp.A * s) * r[:, None],
        qp.l * r,
        qp.u * r,
        qp.lb / s,
        qp.ub / s,
    )
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
    fresh, kept = (open_workspace("paper_active_set", policy=p) for p in ("fresh", "reuse"))
    kept.setup(sequence.base)
    for step in sequence.steps:
        fresh.setup(sequence.base.at(step))
        kept.update(step)
        fresh.solve()
        kept.solve()
        np.testing.assert_array_equal(kept.read().z, fresh.read().z)
