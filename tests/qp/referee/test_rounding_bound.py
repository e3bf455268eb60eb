"""The rounding bound γ_{n+2}, with violations half a unit roundoff below and above it."""

from __future__ import annotations

import numpy as np
import pytest

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.feasibility.rounding import least_violation, limit_sizes
from dpbench.qp.referee.joint import JointQP

U = 2.0**-53
INF = np.inf


def opposed(n: int, violation: float) -> QuadraticProgram:
    """Return rows that bound a sum of n variables by 1 above and 1 + violation below."""
    l, u = [-INF, 1.0 + violation], [1.0, INF]  # noqa: E741 - as in QuadraticProgram
    far = np.full(n, 10.0)
    return QuadraticProgram(np.eye(n), np.ones(n), np.ones((2, n)), l, u, -far, far)


@pytest.mark.parametrize(
    ("n", "units", "undecided"),
    [
        # Violations are multiples of 2 u, the last place of 1 + violation.
        # Both rows are of size 1 + n·1, so that t* is violation/(2 + 2 n). With one variable that
        # is 2.5 u, then 3.5 u against γ_3 = 3 u.
        (1, 10, True),
        (1, 14, False),
        # With three variables 4.5 u, then 5.5 u against γ_5 = 5 u
        (3, 36, True),
        (3, 44, False),
    ],
)
def test_a_violation_is_undecided_up_to_the_bound(n: int, units: int, undecided: bool) -> None:
    """A violation below γ_{n+2} is undecided, one above it is not."""
    assert least_violation(opposed(n, units * U)).undecided is undecided


@pytest.mark.parametrize(("n", "roundings"), [(1, 3), (3, 5)])
def test_the_bound_is_more_than_its_first_order(n: int, roundings: int) -> None:
    """The bound γ_k = k u/(1 − k u) is k u + (k u)² and a little more."""
    bound = least_violation(opposed(n, 2 * U)).rounding
    assert roundings * U < bound < roundings * U * (1.0 + 2 * roundings * U)


@pytest.mark.parametrize(
    ("coefficient", "size"),
    [
        # No more than γ_3 of the largest coefficient of its column: all of it is rounding, and the
        # row takes the size of the others' limits, 4
        (2.5 * U, 4.0),
        # More than that: a coefficient as any other, of a variable that goes up to 4
        (3.5 * U, 14.0 * U),
    ],
)
def test_the_size_of_a_row_whose_coefficients_are_rounding(coefficient: float, size: float) -> None:
    """The row c·z ≤ −2⁻²⁰⁰ stands beside z ≤ 4."""
    qp = QuadraticProgram(
        np.eye(1), [1.0], [[coefficient], [1.0]], [-INF] * 2, [-(2.0**-200), 4.0], [-INF], [INF]
    )
    assert limit_sizes(JointQP.of(qp))[0][0] == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize(
    ("limit", "size"),
    [
        # Of the distances c and 1 the median is a half: up to 3 u of it is rounding and left out
        (1.25 * U, 1.0 + 1.25 * U),
        (1.75 * U, 3.5 * U),
    ],
)
def test_a_distance_that_is_rounding_is_no_reach(limit: float, size: float) -> None:
    """The row z ≤ −c has the size c + reach, beside the bound −1 ≤ z."""
    qp = QuadraticProgram(np.eye(1), [1.0], [[1.0]], [-INF], [-limit], [-1.0], [INF])
    assert limit_sizes(JointQP.of(qp))[0][0] == pytest.approx(size, rel=1e-15)
