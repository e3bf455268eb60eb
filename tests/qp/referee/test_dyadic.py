"""Exact arithmetic on float64 data against Python's fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.qp.referee.dyadic import Dyadic, is_semidefinite, solve_integer

numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e150, max_value=1e150)


def _fractions(value: Dyadic) -> list[Fraction]:
    unit = Fraction(2) ** value.exponent
    return [int(number) * unit for number in value.whole.ravel().tolist()]


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=5))
def test_sums_and_products_are_exact(pairs: list[tuple[float, float]]) -> None:
    """Sum, difference, product and inner product are those of the rational numbers."""
    a, b = (np.array(column) for column in zip(*pairs, strict=True))
    x, y = Dyadic.of(a), Dyadic.of(b)
    exact = [(Fraction(s), Fraction(t)) for s, t in pairs]
    assert _fractions(x + y) == [s + t for s, t in exact]
    assert _fractions(x - y) == [s - t for s, t in exact]
    assert _fractions(x * y) == [s * t for s, t in exact]
    assert _fractions((x * y).sum()) == [sum(s * t for s, t in exact)]
    assert _fractions(Dyadic.of(a[np.newaxis]) @ y) == [sum(s * t for s, t in exact)]


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.lists(numbers, min_size=1, max_size=6))
def test_round_trip(values: list[float]) -> None:
    """A float64 array survives the way there and back bit for bit, signs of values included."""
    array = np.array(values)
    assert (Dyadic.of(array).floats() == array).all()
    assert (Dyadic.of(array).signs() == np.sign(array)).all()


@pytest.mark.parametrize("seed", range(10))
def test_integer_elimination_solves(seed: int) -> None:
    """The numerators over the denominator satisfy the system exactly."""
    rng = np.random.default_rng(seed)
    n, w = 5, 3
    B, G = rng.integers(-5, 6, (n, n)), rng.integers(-5, 6, (w, n))
    K = np.block([[B.T @ B + np.eye(n, dtype=int), G.T], [G, np.zeros((w, w), dtype=int)]])
    M, rhs = K.astype(object), rng.integers(-9, 10, (n + w, 2)).astype(object)
    solved = solve_integer(M, rhs)
    assert solved is not None
    x, denominator = solved
    assert denominator > 0
    assert (M @ x == rhs * denominator).all()


def test_integer_elimination_reports_dependent_rows() -> None:
    """A KKT matrix with a repeated row is reported as singular."""
    K = np.array([[2, 0, 1, 1], [0, 2, 1, 1], [1, 1, 0, 0], [1, 1, 0, 0]]).astype(object)
    assert solve_integer(K, np.ones((4, 1), dtype=int).astype(object)) is None


@pytest.mark.parametrize("seed", range(10))
def test_semidefinite_is_decided_exactly(seed: int) -> None:
    """BᵀB is semidefinite whatever its rank, and no longer so after any shift down by one unit."""
    rng = np.random.default_rng(seed)
    B = rng.integers(-1000, 1001, (3, 6))
    S = (B.T @ B).astype(object)
    assert is_semidefinite(S)
    for i in range(6):
        shifted = S * 1000
        shifted[i, i] -= 1
        # Rank 3 in six dimensions: each axis has a part in the null space.
        assert not is_semidefinite(shifted)
