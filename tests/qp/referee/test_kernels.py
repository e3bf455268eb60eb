"""Exact arithmetic and compiled kernels against fractions; nearby active sets."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from numba import njit
from numpy.typing import NDArray

from dpbench.qp.referee import kernels, referee
from dpbench.qp.referee.dyadic import (
    Dyadic,
    is_integer_matrix_semidefinite,
    solve_integer_system_exactly,
)
from dpbench.qp.referee.guesses import guess_active_set_from_last_step
from dpbench.qp.referee.kernels import (
    CROSSED_LIMITS,
    INVALID_DATA,
    ORDERED_LIMITS,
    classify_limits_as_ordered_crossed_or_nan,
    prove_active_set_optimal,
)
from dpbench.qp.referee.kkt import Geometry, KKTSystem, prove_optimum_by_kkt_error_bounds
from dpbench.qp.referee.optimum import JointQP
from dpbench.qp.referee.referee import Referee

INF = math.inf
Array = NDArray[np.float64]
UNIT_ROUNDOFF = Fraction(1, 2**53)


@njit
def compiled_residual(K, x, b):  # type: ignore[no-untyped-def]  # compiled: numba finds the types
    """b − K x as the certificate's kernel calculates it, compiled."""
    r = np.zeros(len(b))
    kernels._write_residual_in_double_precision(K, x, b, r)
    return r


def _exactly(K: Array, x: Array, b: Array) -> tuple[list[Fraction], list[Fraction]]:
    """b − K x and |b| + |K||x| in fractions."""
    point, pairs = [Fraction(v) for v in x.tolist()], []
    for row, right in zip(K.tolist(), b.tolist(), strict=True):
        terms = [Fraction(right), *(-Fraction(k) * v for k, v in zip(row, point, strict=True))]
        pairs.append((sum(terms, Fraction(0)), sum(map(abs, terms), Fraction(0))))
    residuals, sizes = zip(*pairs, strict=True)
    return list(residuals), list(sizes)


@pytest.mark.slow
@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), N=st.integers(1, 37), spread=st.sampled_from([0, 3, 60]))
@example(seed=0, N=37, spread=60)
def test_residual_is_that_of_twice_the_precision(seed: int, N: int, spread: int) -> None:
    """Sums of numbers that cancel agree to the last bit, compiled or not, within Dot2's bound."""
    rng = np.random.default_rng(seed)
    # Numbers of all signs, over `spread` powers of two up and down.
    numbers = np.ldexp(rng.normal(size=(N + 1, N)), rng.integers(-spread, spread + 1, (N + 1, N)))
    K, x = np.tril(numbers[:N]) + np.tril(numbers[:N], -1).T, numbers[N]
    # With the product rounded once as the other side, the residual is that rounding.
    b = np.array([-float(value) for value in _exactly(K, x, np.zeros(N))[0]])
    r, interpreted = compiled_residual(K, x, b), np.zeros(N)
    kernels._write_residual_in_double_precision.py_func(K, x, b, interpreted)
    assert (r == interpreted).all()
    steps = (N + 1) * UNIT_ROUNDOFF
    for found, exact, size in zip(r.tolist(), *_exactly(K, x, b), strict=True):
        allowed = UNIT_ROUNDOFF * abs(exact) + (steps / (1 - steps)) ** 2 * size
        assert abs(Fraction(found) - exact) <= allowed


@pytest.mark.parametrize("huge", [1e301, 1e308])
def test_what_overflows_proves_nothing(huge: float) -> None:
    problem = JointQP(np.eye(1), np.array([-huge]), np.eye(1), np.array([-INF]), np.array([INF]))
    system = KKTSystem(problem.P, problem.C, np.zeros(1, dtype=np.int8))
    assert prove_optimum_by_kkt_error_bounds(problem, Geometry(problem.C), system) is None


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    sizes=st.tuples(st.integers(1, 7), st.integers(0, 5)),
    condition=st.integers(0, 30),
)
def test_enclosure_holds_the_exact_solution(
    seed: int, sizes: tuple[int, int], condition: int
) -> None:
    rng = np.random.default_rng(seed)
    n, m = sizes
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    P = (Q * 2.0 ** -np.linspace(0.0, condition, n)) @ Q.T
    P, C = 0.5 * (P + P.T), np.vstack((rng.normal(size=(m, n)), np.eye(n)))
    signs = rng.integers(-1, 2, n + m).astype(np.int8)
    system = KKTSystem(P, C, signs)
    if not system.is_proven_nonsingular:
        return
    q, L, U = rng.normal(size=n), -rng.random(n + m), rng.random(n + m)
    bound, x, error, y = _certified(JointQP(P, q, C, L, U), system)
    exact = solve_exactly(system.K, system.build_right_hand_side(q, L, U))
    for near, within, value in zip(x.tolist(), error.tolist(), exact, strict=True):
        assert abs(Fraction(near) - value) <= Fraction(within)
    # Half a unit in the last place, and what α makes of the largest of them.
    spread = 2.0 * system.alpha * np.abs(x / system.weight).max() * system.weight
    assert (error <= 2.0**-52 * (np.abs(x) + spread) + 1e-280).all()
    if bound < INF:
        assert bound == error[:n].max()
        assert (y[system.rows] == x[n:]).all() and np.count_nonzero(y) == len(system.rows)


def _certified(problem: JointQP, system: KKTSystem) -> Any:
    geometry = Geometry(problem.C)
    return prove_active_set_optimal(
        *(problem.q, problem.L, problem.U, geometry.C_T, geometry.gamma),
        *(system.K, system.X_T, system.weight, system.rows, system.signs),
        *(system.alpha, system.gamma),
    )


def solve_exactly(K: Array, b: Array) -> list[Fraction]:
    N = len(b)
    rows = [[Fraction(v) for v in (*K[i].tolist(), float(b[i]))] for i in range(N)]
    for k in range(N):
        p = next(i for i in range(k, N) if rows[i][k])
        rows[k], rows[p] = rows[p], rows[k]
        rows[k] = [v / rows[k][k] for v in rows[k]]
        for i in range(N):
            if i != k:
                rows[i] = [a - rows[i][k] * c for a, c in zip(rows[i], rows[k], strict=True)]
    return [row[N] for row in rows]


@pytest.mark.parametrize(
    ("q", "L", "U", "expected"),
    [
        (0.0, [0.0, -INF], [0.0, INF], ORDERED_LIMITS),
        (0.0, [1.0, -INF], [0.0, INF], CROSSED_LIMITS),
        (0.0, [1.0, INF], [0.0, INF], INVALID_DATA),
        (0.0, [0.0, -INF], [0.0, -INF], INVALID_DATA),
        (0.0, [math.nan, 0.0], [0.0, 0.0], INVALID_DATA),
        (0.0, [0.0, 0.0], [0.0, math.nan], INVALID_DATA),
        (math.nan, [0.0, 0.0], [0.0, 0.0], INVALID_DATA),
        (-INF, [0.0, 0.0], [0.0, 0.0], INVALID_DATA),
    ],
)
def test_invalid_data_count_before_crossed_limits(q: Any, L: Any, U: Any, expected: int) -> None:
    assert (
        classify_limits_as_ordered_crossed_or_nan(np.array([q]), np.array(L), np.array(U))
        == expected
    )


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 8), changes=st.integers(0, 8))
def test_nearby_set_is_that_of_the_optimum(seed: int, n: int, changes: int) -> None:
    rng = np.random.default_rng(seed)
    P, target, ones = np.diag(rng.uniform(0.5, 2.0, n)), rng.uniform(-2.0, 2.0, n), np.ones(n)
    problem = JointQP(P, -P @ target, np.eye(n), -ones, ones)
    optimal = np.where(np.abs(target) > 1.0, np.sign(target), 0.0).astype(np.int8)
    begun, changed = optimal.copy(), rng.permutation(n)[:changes]
    begun[changed] = rng.integers(-1, 2, len(changed))
    found = guess_active_set_from_last_step(
        problem, Geometry(problem.C), KKTSystem(P, problem.C, begun)
    )
    assert found is not None and (found == optimal).all()


def test_nearby_gives_up_without_a_point() -> None:
    C, U = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([1.0, 1.0, INF])
    problem = JointQP(np.eye(2), np.array([-3.0, 0.0]), C, np.full(3, -INF), U)
    for begun in (np.zeros(3, dtype=np.int8), np.array([0, 0, 1], dtype=np.int8)):
        assert (
            guess_active_set_from_last_step(problem, Geometry(C), KKTSystem(problem.P, C, begun))
            is None
        )


def test_a_nearby_set_that_is_wrong_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    P, A, ones = np.eye(4) + 0.3, rng.normal(size=(3, 4)), np.ones(4)
    steps = [(2 * rng.normal(size=4), -rng.random(3), rng.random(3)) for _ in range(20)]
    honest, deceived = Referee(P, A, -ones, ones), Referee(P, A, -ones, ones)
    known = [honest.certify_vectors(*step) for step in steps]

    lie = lambda *_: rng.integers(-1, 2, 7).astype(np.int8)  # noqa: E731
    monkeypatch.setattr(referee, "guess_active_set_from_last_step", lie)
    for step, optimum in zip(steps, known, strict=True):
        found = deceived.certify_vectors(*step)
        assert found.kind == optimum.kind == "linear"
        assert np.abs(found.z - optimum.z).max() <= found.bound + optimum.bound <= 1e-12


def test_sets_that_change_by_little_need_no_guesser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(referee, "yield_active_set_guesses", lambda problem: pytest.fail("guessed"))
    n, none = 5, np.zeros(0)
    steady = Referee(np.eye(n) + 0.1, np.zeros((0, n)), -np.ones(n), np.ones(n))
    sets = set()
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        optimum = steady.certify_vectors(3.0 * np.sin(angle + np.arange(n)), none, none)
        assert optimum.kind == "linear" and optimum.bound <= 1e-15
        sets.add(np.sign(optimum.y_box).tobytes())
    assert len(sets) >= 10


def test_any_memory_of_the_vectors_is_taken() -> None:
    P, none, ones = np.eye(3), np.zeros((0, 3)), np.ones(3)
    plain = Referee(P, none, -ones, ones).certify_vectors(
        np.array([-2.0, 0.5, 0.0]), ones[:0], ones[:0]
    )
    compiled = (
        len(classify_limits_as_ordered_crossed_or_nan.signatures),
        len(prove_active_set_optimal.signatures),
    )
    q = np.array([-2.0, 9.0, 0.5, 9.0, 0.0, 9.0])
    q.setflags(write=False)
    strided = Referee(P, none, -ones, ones).certify_vectors(q[::2], ones[:0], ones[:0])
    assert (strided.z == plain.z).all() and strided.kind == plain.kind == "linear"
    assert compiled == (
        len(classify_limits_as_ordered_crossed_or_nan.signatures),
        len(prove_active_set_optimal.signatures),
    )


numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e150, max_value=1e150)


def _fractions(value: Dyadic) -> list[Fraction]:
    unit = Fraction(2) ** value.exponent
    return [int(number) * unit for number in value.whole.ravel().tolist()]


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=5))
def test_sums_and_products_are_exact(pairs: list[tuple[float, float]]) -> None:
    a, b = (np.array(column) for column in zip(*pairs, strict=True))
    x, y = Dyadic.from_floats(a), Dyadic.from_floats(b)
    exact = [(Fraction(s), Fraction(t)) for s, t in pairs]
    assert _fractions(x + y) == [s + t for s, t in exact]
    assert _fractions(x - y) == [s - t for s, t in exact]
    assert _fractions(x * y) == [s * t for s, t in exact]
    assert _fractions((x * y).exact_sum()) == [sum(s * t for s, t in exact)]
    assert _fractions(Dyadic.from_floats(a[np.newaxis]) @ y) == [sum(s * t for s, t in exact)]


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.lists(numbers, min_size=1, max_size=6))
def test_round_trip(values: list[float]) -> None:
    """A float64 array survives the way there and back bit for bit, signs of values included."""
    array = np.array(values)
    assert (Dyadic.from_floats(array).round_to_floats() == array).all()
    assert (Dyadic.from_floats(array).entry_signs() == np.sign(array)).all()


@pytest.mark.parametrize("seed", range(10))
def test_integer_elimination_solves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, w = 5, 3
    B, G = rng.integers(-5, 6, (n, n)), rng.integers(-5, 6, (w, n))
    K = np.block([[B.T @ B + np.eye(n, dtype=int), G.T], [G, np.zeros((w, w), dtype=int)]])
    M, rhs = K.astype(object), rng.integers(-9, 10, (n + w, 2)).astype(object)
    solved = solve_integer_system_exactly(M, rhs)
    assert solved is not None
    x, denominator = solved
    assert denominator > 0
    assert (M @ x == rhs * denominator).all()


def test_integer_elimination_reports_dependent_rows() -> None:
    K = np.array([[2, 0, 1, 1], [0, 2, 1, 1], [1, 1, 0, 0], [1, 1, 0, 0]]).astype(object)
    assert solve_integer_system_exactly(K, np.ones((4, 1), dtype=int).astype(object)) is None


@pytest.mark.parametrize("seed", range(10))
def test_semidefinite_is_decided_exactly(seed: int) -> None:
    """BᵀB is semidefinite whatever its rank, and no longer so after any shift down by one unit."""
    rng = np.random.default_rng(seed)
    B = rng.integers(-1000, 1001, (3, 6))
    S = (B.T @ B).astype(object)
    assert is_integer_matrix_semidefinite(S)
    for i in range(6):
        shifted = S * 1000
        shifted[i, i] -= 1
        # Rank 3 in six dimensions: each axis has a part in the null space.
        assert not is_integer_matrix_semidefinite(shifted)
