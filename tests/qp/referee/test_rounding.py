"""Infeasible by rounding or in earnest: planted violations of known size."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.feasibility.farkas import farkas_valid
from dpbench.qp.referee.feasibility.rounding import least_violation, limit_sizes
from dpbench.qp.referee.joint import JointQP
from dpbench.qp.referee.referee import certify

INF = np.inf
SCALES = [1.0, 2.0**20, 2.0**-20]
"""Powers of two, 1e6 and 1e-6 nearly: the planted violation stays exact."""


def _opposed(violation: float, scale: float, n: int = 3) -> QuadraticProgram:
    """z_1 + … + z_n at most `scale` by one row, at least scale·(1 + violation) by another."""
    A = np.ones((2, n))
    l, u = [-INF, scale * (1.0 + violation)], [scale, INF]  # noqa: E741 - as in QuadraticProgram
    free = np.full(n, 10.0 * scale)
    return QuadraticProgram(np.eye(n), np.ones(n), A, l, u, -free, free)


def _hollow(violation: float, scale: float) -> QuadraticProgram:
    """A row 0·z ≤ −violation·scale among rows of limits `scale`, as where a state is given."""
    A = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, -1.0]])
    u = np.array([-violation, 1.0, 1.0]) * scale
    free = np.full(2, INF)
    return QuadraticProgram(np.eye(2), np.ones(2), A, np.full(3, -INF), u, -free, free)


def _touching(violation: float, scale: float) -> QuadraticProgram:
    """z ≥ 0 by a bound and z ≤ −violation·scale by a row, in a box of size `scale`."""
    return QuadraticProgram(np.eye(1), [1.0], [[1.0]], [-INF], [-violation * scale], [0.0], [scale])


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("plant", [_hollow, _touching])
@pytest.mark.parametrize(
    ("violation", "kind"),
    [(1e-17, "undecided"), (1e-16, "undecided"), (1e-12, "infeasible"), (1e-3, "infeasible")],
)
def test_planted_violation(plant: object, violation: float, kind: str, scale: float) -> None:
    """A violation of 1e-16 of the numbers around it is undecided, one of 1e-12 is not."""
    qp = plant(violation, scale)  # type: ignore[operator]  # one of the functions above
    optimum = certify(qp)
    assert optimum.kind == kind
    assert np.isnan(optimum.z).all()
    assert optimum.bound == INF
    assert farkas_valid(qp, optimum.y, optimum.y_box)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(
    ("violation", "kind"), [(2.0**-52, "undecided"), (1e-12, "infeasible"), (1e-3, "infeasible")]
)
@pytest.mark.parametrize("n", [3, 60])
def test_opposed_rows(n: int, violation: float, kind: str, scale: float) -> None:
    """Two rows that exclude one another by one unit in the last place are undecided."""
    assert certify(_opposed(violation, scale, n)).kind == kind


@pytest.mark.parametrize("row", [True, False])
@pytest.mark.parametrize("limit", [1.0, -7.7, 1e9, 1e-9])
def test_crossed_limits(limit: float, row: bool) -> None:
    """Limits crossed by one unit in the last place are undecided, by 1e-12 of them infeasible."""
    for below, kind in (
        (np.nextafter(limit, -INF), "undecided"),
        (limit - 1e-12 * abs(limit), "infeasible"),
        (limit - abs(limit), "infeasible"),
    ):
        l, u = ([limit], [below]) if row else ([-INF], [INF])  # noqa: E741 - as in QuadraticProgram
        lb, ub = ([-INF], [INF]) if row else ([limit], [below])
        qp = QuadraticProgram(np.eye(1), [0.0], np.eye(1), l, u, lb, ub)
        assert certify(qp).kind == kind


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None)
@given(
    st.floats(-30.0, -1.0).map(lambda power: 10.0**power),
    st.sampled_from([_hollow, _touching]),
    st.sampled_from(SCALES),
)
def test_bounds_enclose_the_least_violation(violation: float, plant: object, scale: float) -> None:
    """lower ≤ t* ≤ upper, with t* by hand in fractions; the verdict is that of t* and γ."""
    qp = plant(violation, scale)  # type: ignore[operator]  # one of the functions above
    upper, lower = limit_sizes(JointQP.of(qp))
    # The row must rise, and the bound z ≥ 0 may fall to meet it.
    room = Fraction(float(upper[0])) + (Fraction(float(lower[1])) if qp.n == 1 else 0)
    exact = Fraction(float(-qp.u[0])) / room
    optimum = certify(qp)
    found = least_violation(qp, np.concatenate((optimum.y, optimum.y_box)))
    assert Fraction(found.lower) <= exact
    assert found.lower >= 0.999 * float(exact)
    if found.upper < INF:
        assert exact <= Fraction(found.upper)
    assert found.undecided is (exact <= Fraction(found.rounding))
    assert optimum.kind == ("undecided" if found.undecided else "infeasible")


def _cycle(seed: int, n: int, m: int, share: float) -> QuadraticProgram:
    """Rows that meet in one point, with Σ y_i a_i = 0, y > 0, less `share` of one limit.

    That limit is 0 in the point, so that any share leaves a float64 number.
    """
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
    """A genuine violation stays one when a single row is written in units 1e6 times smaller."""
    qp = _opposed(1e-6, 1.0)
    for unit in (2.0**20, 2.0**-20):
        A, u, l = qp.A.copy(), qp.u.copy(), qp.l.copy()  # noqa: E741 - as in QuadraticProgram
        A[0], u[0], l[0] = unit * A[0], unit * u[0], unit * l[0]
        assert certify(replace(qp, A=A, u=u, l=l)).kind == "infeasible"


@pytest.mark.parametrize("huge", [1e10, 1e20, 1e30])
def test_huge_limits_hide_no_violation(huge: float) -> None:
    """Numbers that stand for infinity do not make the rounding of others larger."""
    A = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    qp = QuadraticProgram(
        np.eye(2),
        np.ones(2),
        A,
        [-huge, 1.0 + 1e-9, -huge, -huge],
        [1.0, huge, huge, huge],
        [-huge] * 2,
        [huge] * 2,
    )
    assert certify(qp).kind == "infeasible"


def test_thin_feasible_sets_stay_feasible() -> None:
    """Equalities, dependent ones and a forced vertex have optima, thin as their sets are."""
    free = np.full(2, INF)
    A = np.array([[1.0, 2.0], [2.0, 4.0], [1.0, -1.0]])
    twice = QuadraticProgram(np.eye(2), [1.0, 1.0], A[:2], [1.0, 2.0], [1.0, 2.0], -free, free)
    vertex = QuadraticProgram(
        np.eye(2), [1.0, 1.0], A, [3.0, 6.0, 0.0], [3.0, 6.0, 0.0], -free, free
    )
    ones = np.ones(2)
    forced = QuadraticProgram(np.eye(2), ones, [[1.0, 1.0]], [2.0], [INF], -ones, ones)
    for qp, z in ((twice, (-0.2, 0.6)), (vertex, (1.0, 1.0)), (forced, (1.0, 1.0))):
        optimum = certify(qp)
        assert np.abs(optimum.z - z).max() <= optimum.bound + 1e-15
        assert optimum.bound <= 1e-12
