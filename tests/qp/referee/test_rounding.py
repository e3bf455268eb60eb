"""Infeasible by rounding or in earnest: planted violations of known size."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.farkas import (
    bound_least_constraint_violation,
    compute_reference_sizes_of_limits,
    is_farkas_vector_proof,
)
from dpbench.qp.referee.optimum import JointQP
from dpbench.qp.referee.referee import certify

INF = np.inf
SCALES = [1.0, 2.0**20, 2.0**-20]
"""Powers of two, 1e6 and 1e-6 nearly: the planted violation stays exact."""


def _opposed(violation: float, scale: float, n: int = 3) -> QuadraticProgram:
    """z_1 + … + z_n at most `scale` by one row, at least scale·(1 + violation) by another."""
    limits, box = ([-INF, scale * (1.0 + violation)], [scale, INF]), np.full(n, 10.0 * scale)
    return QuadraticProgram(np.eye(n), np.ones(n), np.ones((2, n)), *limits, -box, box)


def _hollow(violation: float, scale: float) -> QuadraticProgram:
    """A row 0·z ≤ −violation·scale among rows of limits `scale`, as where a state is given."""
    A = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, -1.0]])
    limits = np.full(3, -INF), np.array([-violation, 1.0, 1.0]) * scale
    return QuadraticProgram(np.eye(2), np.ones(2), A, *limits, [-INF] * 2, [INF] * 2)


def _touching(violation: float, scale: float) -> QuadraticProgram:
    """z ≥ 0 by a bound and z ≤ −violation·scale by a row, in a box of size `scale`."""
    return QuadraticProgram(np.eye(1), [1.0], [[1.0]], [-INF], [-violation * scale], [0.0], [scale])


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("plant", [_hollow, _touching])
@pytest.mark.parametrize("violation", [1e-17, 1e-16, 1e-12, 1e-3])
def test_planted_violation(plant: Any, violation: float, scale: float) -> None:
    qp = plant(violation, scale)
    optimum = certify(qp)
    assert optimum.kind == ("undecided" if violation < 1e-14 else "infeasible")
    assert np.isnan(optimum.z).all() and optimum.bound == INF
    assert is_farkas_vector_proof(qp, optimum.y, optimum.y_box)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("violation", [2.0**-52, 1e-12, 1e-3])
@pytest.mark.parametrize("n", [3, 60])
def test_opposed_rows(n: int, violation: float, scale: float) -> None:
    expected = "undecided" if violation < 1e-14 else "infeasible"
    assert certify(_opposed(violation, scale, n)).kind == expected


@pytest.mark.parametrize("row", [True, False])
@pytest.mark.parametrize("limit", [1.0, -7.7, 1e9, 1e-9])
def test_crossed_limits(limit: float, row: bool) -> None:
    for below, kind in (
        (np.nextafter(limit, -INF), "undecided"),
        (limit - 1e-12 * abs(limit), "infeasible"),
        (limit - abs(limit), "infeasible"),
    ):
        crossed, free = ([limit], [below]), ([-INF], [INF])
        limits = (*crossed, *free) if row else (*free, *crossed)
        optimum = certify(qp := QuadraticProgram(np.eye(1), [0.0], np.eye(1), *limits))
        assert optimum.kind == kind
        assert is_farkas_vector_proof(qp, optimum.y, optimum.y_box)


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None)
@given(
    st.floats(-30.0, -1.0).map(lambda power: 10.0**power),
    st.sampled_from([_hollow, _touching]),
    st.sampled_from(SCALES),
)
def test_bounds_enclose_the_least_violation(violation: float, plant: Any, scale: float) -> None:
    """lower ≤ t* ≤ upper, with t* by hand in fractions; the verdict is that of t* and γ."""
    qp = plant(violation, scale)
    upper, lower = compute_reference_sizes_of_limits(JointQP.from_qp(qp))
    # The row must rise, and the bound z ≥ 0 may fall to meet it.
    room = Fraction(float(upper[0])) + (Fraction(float(lower[1])) if qp.n == 1 else 0)
    exact = Fraction(float(-qp.u[0])) / room
    optimum = certify(qp)
    found = bound_least_constraint_violation(qp, np.concatenate((optimum.y, optimum.y_box)))
    assert Fraction(found.lower) <= exact
    assert found.lower >= 0.999 * float(exact)
    if found.upper < INF:
        assert exact <= Fraction(found.upper)
    assert found.is_undecided is (exact <= Fraction(found.rounding))
    assert optimum.kind == ("undecided" if found.is_undecided else "infeasible")


def _cycle(seed: int, n: int, m: int, share: float) -> QuadraticProgram:
    """Rows that meet in one point, with Σ y_i a_i = 0, y > 0, less `share` of one limit."""
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (m, n)).astype(float)
    z = rng.integers(1, 17, n) / 8
    z[0] = 0.125
    A[0, 0] -= 8.0 * float(A[0] @ z)
    y = rng.choice([1.0, 2.0], m)
    y[-1] = 1.0
    A[-1] = -y[:-1] @ A[:-1]
    u = A @ z
    u[0] = -share
    box = np.full(n, 100.0)
    return QuadraticProgram(np.eye(n), rng.normal(size=n), A, np.full(m, -INF), u, -box, box)


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 8), st.integers(3, 9))
def test_many_rows_together(seed: int, n: int, m: int) -> None:
    """Rows that exclude one another together, by 1e-6 or by 1e-18 of the numbers around them."""
    assert certify(_cycle(seed, n, m, 1e-6)).kind == "infeasible"
    assert certify(_cycle(seed, n, m, 1e-18)).kind == "undecided"


def test_units_of_a_row_do_not_matter() -> None:
    qp = _opposed(1e-6, 1.0)
    for unit in (2.0**20, 2.0**-20):
        A, u, l = qp.A.copy(), qp.u.copy(), qp.l.copy()  # noqa: E741 - as in QuadraticProgram
        A[0], u[0], l[0] = unit * A[0], unit * u[0], unit * l[0]
        assert certify(replace(qp, A=A, u=u, l=l)).kind == "infeasible"


@pytest.mark.parametrize("huge", [1e10, 1e20, 1e30])
def test_huge_limits_hide_no_violation(huge: float) -> None:
    A = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    limits = [-huge, 1.0 + 1e-9, -huge, -huge], [1.0, huge, huge, huge], [-huge] * 2, [huge] * 2
    qp = QuadraticProgram(np.eye(2), np.ones(2), A, *limits)
    assert certify(qp).kind == "infeasible"


def test_thin_feasible_sets_stay_feasible() -> None:
    free, ones, A = np.full(2, INF), np.ones(2), np.array([[1.0, 2.0], [2.0, 4.0], [1.0, -1.0]])
    equal = [3.0, 6.0, 0.0]
    twice = QuadraticProgram(np.eye(2), ones, A[:2], [1.0, 2.0], [1.0, 2.0], -free, free)
    vertex = QuadraticProgram(np.eye(2), ones, A, equal, equal, -free, free)
    forced = QuadraticProgram(np.eye(2), ones, [[1.0, 1.0]], [2.0], [INF], -ones, ones)
    for qp, z in ((twice, (-0.2, 0.6)), (vertex, (1.0, 1.0)), (forced, (1.0, 1.0))):
        optimum = certify(qp)
        assert np.abs(optimum.z - z).max() <= optimum.bound + 1e-15
        assert optimum.bound <= 1e-12


U = 2.0**-53


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
    assert bound_least_constraint_violation(_opposed(units * U, 1.0, n)).is_undecided is undecided


@pytest.mark.parametrize(("n", "roundings"), [(1, 3), (3, 5)])
def test_the_bound_is_more_than_its_first_order(n: int, roundings: int) -> None:
    """The bound γ_k = k u/(1 − k u) is k u + (k u)² and a little more."""
    bound = bound_least_constraint_violation(_opposed(2 * U, 1.0, n)).rounding
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
    assert compute_reference_sizes_of_limits(JointQP.from_qp(qp))[0][0] == pytest.approx(
        size, rel=1e-12
    )


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
    assert compute_reference_sizes_of_limits(JointQP.from_qp(qp))[0][0] == pytest.approx(
        size, rel=1e-15
    )
