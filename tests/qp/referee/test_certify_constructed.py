"""Certified optima of problems built around a known optimum.

z*, its multipliers and all matrices are small multiples of 1/8, so that q, l and u come out exact
in float64 and z* is the optimum to the last bit: no tolerance for the construction is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import Referee, certify
from dpbench.qp.residuals import best_multipliers, is_true, residuals
from dpbench.qp.solution import Solution, Status

BOUND = 1e-9
"""What the assessment of errors of 1e-6 and more needs, with room to spare."""
ROLES = ("strict", "weak", "equal", "inactive", "one_sided", "free", "copy_strict", "copy_weak")


@dataclass(frozen=True)
class Known:
    """A problem and its optimum."""

    qp: QuadraticProgram
    z: NDArray[np.float64]


def _limits(
    rng: np.random.Generator, value: float, role: str, side: int
) -> tuple[float, float, float]:
    """Lower limit, upper limit and multiplier of a row with this value and role."""
    near, far = value, value - side * rng.integers(1, 16) / 8
    size = rng.integers(1, 16) / 8
    if role == "equal":
        return value, value, side * size
    if role == "free":
        return -np.inf, np.inf, 0.0
    if role == "one_sided":
        return (-np.inf, value, size) if side > 0 else (value, np.inf, -size)
    if role == "inactive":
        return value - rng.integers(1, 16) / 8, value + size, 0.0
    lower, upper = (far, near) if side > 0 else (near, far)
    return lower, upper, side * size if role.endswith("strict") else 0.0


def build(seed: int, roles: list[str], bounds: list[str], condition: int = 1) -> Known:
    """A problem whose rows and bounds play the given roles at its optimum.

    A "copy" row repeats an earlier row or, if there is none, a bound; `condition` spreads the
    eigenvalues of P by that power of two.
    """
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
    rows = [
        _limits(rng, value, role, side)
        for value, role, side in zip(C @ z, [*roles, *bounds], sides, strict=True)
    ]
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
    """The certified optimum is within its bound of the true one, and the bound is at most 1e-9."""
    _agrees(known)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from(["strict", "inactive", "one_sided", "free"]), max_size=6),
    st.integers(1, 6),
)
def test_active_bounds_alone_give_a_linear_certificate(seed: int, roles: list[str], n: int) -> None:
    """Strictly active independent limits are certified by the linear certificate."""
    rows = ["inactive" if role in ("strict", "one_sided") else role for role in roles]
    bounds = [("strict", "inactive")[(seed >> i) & 1] for i in range(n)]
    known = build(seed, rows, bounds)
    assert certify(known.qp).kind == "linear"
    _agrees(known)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("n", [15, 30])
def test_weak_activity_at_full_size(n: int, seed: int) -> None:
    """Weakly active independent limits of a full-sized problem are certified to 1e-9."""
    rng = np.random.default_rng(seed)
    bounds = rng.choice(["strict", "weak", "inactive"], n, p=[0.3, 0.3, 0.4]).tolist()
    rows = ["inactive"] * n
    known = build(seed, rows, bounds, 2**10)
    assert certify(known.qp).kind == "gap"
    _agrees(known)


@pytest.mark.parametrize("multiplier", [0.0, 0.5])
def test_first_amplitude_row_equal_to_the_rate_bound(multiplier: float) -> None:
    """A row of summed moves that coincides with a bound on the first move is no obstacle."""
    A = np.kron(np.tril(np.ones((5, 5))), np.eye(3))
    n = 15
    ones = np.ones(n)
    u = 3.0 * ones
    u[0] = 1.0
    P = 4.0 * np.eye(n) + A.T @ A
    z = np.zeros(n)
    z[0] = 1.0
    y = multiplier * np.eye(n)[0]
    q = -(P @ z + A.T @ y + y)
    _agrees(Known(QuadraticProgram(P, q, A, -3.0 * ones, u, -ones, ones, block=3), z))


def test_more_active_rows_than_variables() -> None:
    """A vertex where many more limits meet than there are variables is certified."""
    angles = [(1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (-1, 2), (2, -1)]
    A = np.array(angles, dtype=float)
    z = np.array([0.5, -0.25])
    values = A @ z
    P = np.array([[2.0, 1.0], [1.0, 2.0]])
    y = np.array([1.0, 1.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.25])
    q = -(P @ z + A.T @ y)
    free = np.full(2, np.inf)
    _agrees(Known(QuadraticProgram(P, q, A, values - 1.0, values, -free, free), z))


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None)
@given(problems)
def test_certified_multipliers_explain_the_optimum(known: Known) -> None:
    """The certified optimum, its own multipliers or the best ones, is true at 1e-6."""
    qp = known.qp
    optimum = certify(qp)
    own = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
    best = Solution(Status.UNKNOWN, known.z, *best_multipliers(qp, known.z, 1e-6))
    for answer in (own, best):
        assert is_true(qp, residuals(qp, answer), 0.0, 1e-6)
        # 1e-9 of the size of the multipliers, which are below 2^25 here.
        assert residuals(qp, answer).complementarity <= 1e-9 * (1.0 + np.abs(qp.q).max())


@pytest.mark.slow
@settings(max_examples=40, derandomize=True, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_order_of_problems_does_not_matter(seed: int, n: int) -> None:
    """A referee that has seen other problems certifies within the bounds of a fresh one."""
    rng = np.random.default_rng(seed)
    base = build(seed, ["inactive", "copy_weak"], ["strict"] * n).qp
    referee = Referee(base.P, base.A, base.lb, base.ub)
    for _ in range(6):
        q = rng.integers(-64, 65, n) / 8
        one = referee.certify(q, base.l, base.u)
        two = certify(QuadraticProgram(base.P, q, base.A, base.l, base.u, base.lb, base.ub))
        assert np.abs(one.z - two.z).max() <= one.bound + two.bound <= BOUND
