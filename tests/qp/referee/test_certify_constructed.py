"""Certified optima of problems built around a known optimum."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.implied import fix_variables_forced_to_bounds
from dpbench.qp.referee.optimum import ExactMatrices, JointQP
from dpbench.qp.referee.rational import prove_optimum_in_exact_arithmetic
from dpbench.qp.referee.referee import certify
from dpbench.qp.residuals import are_answers_correct, fit_row_and_bound_multipliers, residuals
from dpbench.qp.solution import Solution, Status

BOUND = 1e-9
"""Bound of the error that the assessment of errors of 1e-6 and more needs, with room to spare."""
ROLES = ("strict", "weak", "equal", "inactive", "one_sided", "free", "copy_strict", "copy_weak")


@dataclass(frozen=True)
class Known:
    qp: QuadraticProgram
    z: NDArray[np.float64]


def _limits(
    rng: np.random.Generator, value: float, role: str, side: int
) -> tuple[float, float, float]:
    """Lower limit, upper limit and multiplier of a row with this value and role."""
    far, size = value - side * rng.integers(1, 16) / 8, rng.integers(1, 16) / 8
    if role == "equal":
        return value, value, side * size
    if role == "free":
        return -np.inf, np.inf, 0.0
    if role == "one_sided":
        return (-np.inf, value, size) if side > 0 else (value, np.inf, -size)
    if role == "inactive":
        return value - rng.integers(1, 16) / 8, value + size, 0.0
    return min(value, far), max(value, far), side * size if role.endswith("strict") else 0.0


def build(seed: int, roles: list[str], bounds: list[str], condition: int = 1) -> Known:
    """A problem whose rows and bounds play the given roles at its optimum."""
    rng = np.random.default_rng(seed)
    n, m = len(bounds), len(roles)
    B = rng.integers(-2, 3, (n, n)).astype(float)
    P = condition * B.T @ B + np.eye(n)
    A = rng.integers(-2, 3, (m, n)).astype(float)
    for i, role in enumerate(roles):
        if role.startswith("copy"):
            A[i] = A[rng.integers(i)] if i and rng.random() < 0.5 else np.eye(n)[rng.integers(n)]
    z = rng.integers(-16, 17, n) / 8
    sides = rng.choice([-1, 1], m + n)
    C = np.vstack((A, np.eye(n)))
    places = zip(C @ z, [*roles, *bounds], sides, strict=True)
    rows = [_limits(rng, value, role, side) for value, role, side in places]
    lower, upper, y = (np.array(column) for column in zip(*rows, strict=True))
    q = -(P @ z + C.T @ y)
    return Known(QuadraticProgram(P, q, A, lower[:m], upper[:m], lower[m:], upper[m:]), z)


def _agrees(known: Known) -> None:
    optimum = certify(known.qp)
    assert optimum.kind in ("linear", "gap", "rational")
    assert np.abs(optimum.z - known.z).max() <= optimum.bound <= BOUND


problems = st.builds(
    build,
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from(ROLES), max_size=9),
    st.lists(st.sampled_from(ROLES[:6]), min_size=1, max_size=6),
    st.sampled_from([1, 2**10, 2**20]),
)


@pytest.mark.slow
@settings(max_examples=250, derandomize=True, deadline=None)
@given(problems)
def test_bound_holds_whatever_is_active(known: Known) -> None:
    _agrees(known)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from(["strict", "inactive", "one_sided", "free"]), max_size=6),
    st.integers(1, 6),
)
def test_active_bounds_alone_give_a_linear_certificate(seed: int, roles: list[str], n: int) -> None:
    rows = ["inactive" if role in ("strict", "one_sided") else role for role in roles]
    bounds = [("strict", "inactive")[(seed >> i) & 1] for i in range(n)]
    known = build(seed, rows, bounds)
    assert certify(known.qp).kind == "linear"
    _agrees(known)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("n", [15, 30])
def test_weak_activity_at_full_size(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    bounds = rng.choice(["strict", "weak", "inactive"], n, p=[0.3, 0.3, 0.4]).tolist()
    rows = ["inactive"] * n
    known = build(seed, rows, bounds, 2**10)
    assert certify(known.qp).kind == "gap"
    _agrees(known)


@pytest.mark.parametrize("multiplier", [0.0, 0.5])
def test_first_amplitude_row_equal_to_the_rate_bound(multiplier: float) -> None:
    A, eye, ones = np.kron(np.tri(5), np.eye(3)), np.eye(15), np.ones(15)
    P, z, u = 4.0 * eye + A.T @ A, eye[0], 3.0 * ones - 2.0 * eye[0]
    y = multiplier * z
    q = -(P @ z + A.T @ y + y)
    _agrees(Known(QuadraticProgram(P, q, A, -3.0 * ones, u, -ones, ones, block=3), z))


def test_more_active_rows_than_variables() -> None:
    rows = [(1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (-1, 2), (2, -1)]
    A, z = np.array(rows, dtype=float), np.array([0.5, -0.25])
    P, values = np.array([[2.0, 1.0], [1.0, 2.0]]), A @ z
    y = np.array([1.0, 1.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.25])
    q = -(P @ z + A.T @ y)
    free = np.full(2, np.inf)
    _agrees(Known(QuadraticProgram(P, q, A, values - 1.0, values, -free, free), z))


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None)
@given(problems)
def test_certified_multipliers_explain_the_optimum(known: Known) -> None:
    qp = known.qp
    optimum = certify(qp)
    own = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
    best = Solution(Status.UNKNOWN, known.z, *fit_row_and_bound_multipliers(qp, known.z, 1e-6))
    for answer in (own, best):
        assert are_answers_correct(qp.q[np.newaxis], residuals(qp, answer), 0.0, 1e-6)
        # 1e-9 of the size of the multipliers, which are below 2^25 here.
        assert residuals(qp, answer).complementarity <= 1e-9 * (1.0 + np.abs(qp.q).max())


def _dropped(blocks: int, forced: int, seed: int) -> QuadraticProgram:
    """Summed moves of three axes; the first axis must fall at full rate for `forced` moves."""
    rng = np.random.default_rng(seed)
    n = 3 * blocks
    A = np.kron(np.tril(np.ones((blocks, blocks))), np.eye(3))
    B = rng.normal(size=(n, n))
    # Limits drawn at random are no sums of moves at full rate: all but the forced part is regular.
    u = rng.uniform(4.1, 4.9, n)
    for i in range(blocks):
        u[3 * i] = -(i + 1.0) if i < forced else rng.uniform(0.1, 0.9) - forced
    ones = np.ones(n)
    P = B.T @ B / n + np.eye(n)
    q = 5.0 * rng.normal(size=n)
    return QuadraticProgram(0.5 * (P + P.T), q, A, np.full(n, -9.0), u, -ones, ones, block=3)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("blocks", "forced"), [(5, 1), (5, 3), (5, 5), (10, 6)])
def test_dropped_limit_has_a_cheap_certificate(blocks: int, forced: int, seed: int) -> None:
    qp = _dropped(blocks, forced, seed)
    optimum = certify(qp)
    assert optimum.kind == "linear"
    assert optimum.bound <= 1e-12
    answer = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
    assert are_answers_correct(qp.q[np.newaxis], residuals(qp, answer), 0.0, 1e-6)
    assert residuals(qp, answer).complementarity <= 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_fixing_keeps_the_optimum(seed: int) -> None:
    qp = _dropped(3, 2, seed)
    joint = JointQP.from_qp(qp)
    assert fix_variables_forced_to_bounds(joint) is not None
    guess = np.zeros(qp.n + qp.m, dtype=np.int8)
    exact = prove_optimum_in_exact_arithmetic(
        joint, ExactMatrices.from_float_matrices(joint.P, joint.C), guess
    )
    optimum = certify(qp)
    assert exact is not None
    assert np.abs(exact.z - optimum.z).max() <= exact.bound + optimum.bound


def test_one_bit_of_freedom_is_not_forcing() -> None:
    one, ten = np.ones(1), np.full(1, 10.0)
    for limit, forcing in ((-10.0, True), (np.nextafter(-10.0, 0.0), False)):
        qp = QuadraticProgram(np.eye(1), one, np.eye(1), [-np.inf], [limit], -ten, ten)
        assert (fix_variables_forced_to_bounds(JointQP.from_qp(qp)) is not None) is forcing
        optimum = certify(qp)
        assert abs(optimum.z[0] + 10.0) <= optimum.bound + 2e-15
        assert optimum.bound <= 1e-12


def test_contradicting_rows_are_infeasible() -> None:
    A = np.array([[1.0, 1.0], [1.0, -1.0]])
    ones = np.ones(2)
    qp = QuadraticProgram(np.eye(2), ones, A, [-np.inf, 2.0], [-2.0, np.inf], -ones, ones)
    assert certify(qp).kind == "infeasible"


@settings(derandomize=True, max_examples=60)
@given(st.floats(-np.pi, np.pi), st.floats(0.05, 0.5), st.floats(0.05, 1.0), st.floats(0.05, 1.0))
def test_three_limits_through_one_corner(
    to: float, half: float, along: float, across: float
) -> None:
    """Two sides of a polygon and the edge of a sector meet in (cos, sin) of `to`, but for rounding.

    The cost pulls out of the corner between the normals of one side and of the edge.
    """
    n = 42  # Too large for the rational certificate
    corner = np.array([np.cos(to), np.sin(to)])
    sides = [np.array([np.cos(to + turn), np.sin(to + turn)]) for turn in (-half, half)]
    edge = np.array([np.sin(to), -np.cos(to)])
    A = np.zeros((3, n))
    A[:, :2] = [*sides, edge]
    q = np.zeros(n)
    q[:2] = -(corner + along * sides[1] + across * edge)
    upper, free = np.array([np.cos(half), np.cos(half), 0.0]), np.full(n, 5.0)
    optimum = certify(QuadraticProgram(np.eye(n), q, A, np.full(3, -np.inf), upper, -free, free))
    assert optimum.bound <= 1e-10
    np.testing.assert_allclose(optimum.z[:2], corner, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(optimum.z[2:], 0.0)
