"""The compiled kernels against fractions; the nearby active set against the one that is planted."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba import njit
from numpy.typing import NDArray

from dpbench.qp.referee import kernels, referee
from dpbench.qp.referee.joint import JointQP, Signs
from dpbench.qp.referee.kernels import (
    CROSSED_LIMITS,
    INVALID_DATA,
    ORDERED_LIMITS,
    classify_limits,
    linear_kernel,
)
from dpbench.qp.referee.kkt import Geometry, KKTSystem, linear_certificate
from dpbench.qp.referee.nearby import guess_nearby
from dpbench.qp.referee.referee import Referee

INF = math.inf
UNIT_ROUNDOFF = Fraction(1, 2**53)


@njit
def compiled_residual(K, x, b):  # type: ignore[no-untyped-def]  # compiled: numba finds the types
    """b − K x as the certificate's kernel calculates it, compiled."""
    r = np.zeros(len(b))
    kernels._residual(K, x, b, r)
    return r


def _numbers(rng: np.random.Generator, spread: int, *shape: int) -> NDArray[np.float64]:
    """Numbers of all signs, over `spread` powers of two up and down."""
    return np.ldexp(rng.normal(size=shape), rng.integers(-spread, spread + 1, shape))


def _exactly(
    K: NDArray[np.float64], x: NDArray[np.float64], b: NDArray[np.float64]
) -> tuple[list[Fraction], list[Fraction]]:
    """b − K x and |b| + |K||x| in fractions."""
    residuals, sizes = [], []
    for row, right in zip(K.tolist(), b.tolist(), strict=True):
        terms = [-Fraction(k) * Fraction(v) for k, v in zip(row, x.tolist(), strict=True)]
        residuals.append(Fraction(right) + sum(terms))
        sizes.append(abs(Fraction(right)) + sum(abs(term) for term in terms))
    return residuals, sizes


@pytest.mark.slow
@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), N=st.integers(1, 37), spread=st.sampled_from([0, 3, 60]))
@example(seed=0, N=37, spread=60)
def test_residual_is_that_of_twice_the_precision(seed: int, N: int, spread: int) -> None:
    """Of numbers that cancel, compiled and not: the same to the last bit, within Dot2's bound."""
    rng = np.random.default_rng(seed)
    K, x = np.tril(_numbers(rng, spread, N, N)), _numbers(rng, spread, N)
    K += np.tril(K, -1).T
    # With the product rounded once as the other side, the residual is that rounding.
    b = np.array([-float(value) for value in _exactly(K, x, np.zeros(N))[0]])
    r, interpreted = compiled_residual(K, x, b), np.zeros(N)
    kernels._residual.py_func(K, x, b, interpreted)
    assert (r == interpreted).all()
    steps = (N + 1) * UNIT_ROUNDOFF
    for found, exact, size in zip(r.tolist(), *_exactly(K, x, b), strict=True):
        allowed = UNIT_ROUNDOFF * abs(exact) + (steps / (1 - steps)) ** 2 * size
        assert abs(Fraction(found) - exact) <= allowed


@pytest.mark.parametrize("huge", [1e301, 1e308])
def test_what_overflows_proves_nothing(huge: float) -> None:
    """A point beyond the numbers that can be split is not certified."""
    problem = JointQP(np.eye(1), np.array([-huge]), np.eye(1), np.array([-INF]), np.array([INF]))
    system = KKTSystem(problem.P, problem.C, np.zeros(1, dtype=np.int8))
    assert linear_certificate(problem, Geometry(problem.C), system) is None


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    sizes=st.tuples(st.integers(1, 7), st.integers(0, 5)),
    condition=st.integers(0, 30),
)
def test_enclosure_holds_the_exact_solution(
    seed: int, sizes: tuple[int, int], condition: int
) -> None:
    """Point and multipliers of any active set are in their bounds, which are near to rounding."""
    rng = np.random.default_rng(seed)
    n, m = sizes
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    P = (Q * 2.0 ** -np.linspace(0.0, condition, n)) @ Q.T
    P, C = 0.5 * (P + P.T), np.vstack((rng.normal(size=(m, n)), np.eye(n)))
    signs = rng.integers(-1, 2, n + m).astype(np.int8)
    system = KKTSystem(P, C, signs)
    if not system.proven:
        return
    q, L, U = rng.normal(size=n), -rng.random(n + m), rng.random(n + m)
    bound, x, error, y = _certified(JointQP(P, q, C, L, U), system)
    exact = solve_exactly(system.K, system.rhs(q, L, U))
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
    return linear_kernel(
        *(problem.q, problem.L, problem.U, geometry.C_T, geometry.gamma),
        *(system.K, system.X_T, system.weight, system.rows, system.signs),
        *(system.alpha, system.gamma),
    )


def solve_exactly(K: NDArray[np.float64], b: NDArray[np.float64]) -> list[Fraction]:
    """Gauss-Jordan elimination in fractions."""
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
        ([0.0], [0.0, -INF], [0.0, INF], ORDERED_LIMITS),
        ([0.0], [1.0, -INF], [0.0, INF], CROSSED_LIMITS),
        ([0.0], [1.0, INF], [0.0, INF], INVALID_DATA),
        ([0.0], [0.0, -INF], [0.0, -INF], INVALID_DATA),
        ([0.0], [math.nan, 0.0], [0.0, 0.0], INVALID_DATA),
        ([0.0], [0.0, 0.0], [0.0, math.nan], INVALID_DATA),
        ([math.nan], [0.0, 0.0], [0.0, 0.0], INVALID_DATA),
        ([-INF], [0.0, 0.0], [0.0, 0.0], INVALID_DATA),
    ],
)
def test_meaning(q: list[float], L: list[float], U: list[float], expected: int) -> None:
    """Limits without sense count before crossed ones."""
    assert classify_limits(np.array(q), np.array(L), np.array(U)) == expected


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 8), changes=st.integers(0, 8))
def test_nearby_set_is_that_of_the_optimum(seed: int, n: int, changes: int) -> None:
    """Where variables have no part in each other the method ends, from any set at the optimum."""
    rng = np.random.default_rng(seed)
    P, target, ones = np.diag(rng.uniform(0.5, 2.0, n)), rng.uniform(-2.0, 2.0, n), np.ones(n)
    problem = JointQP(P, -P @ target, np.eye(n), -ones, ones)
    optimal = np.where(np.abs(target) > 1.0, np.sign(target), 0.0).astype(np.int8)
    begun, changed = optimal.copy(), rng.permutation(n)[:changes]
    begun[changed] = rng.integers(-1, 2, len(changed))
    found = guess_nearby(problem, Geometry(problem.C), KKTSystem(P, problem.C, begun))
    assert found is not None and (found == optimal).all()


def test_nearby_gives_up_without_a_point() -> None:
    """The same violated row twice has no point, and an infinite limit no equation."""
    C, U = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([1.0, 1.0, INF])
    problem = JointQP(np.eye(2), np.array([-3.0, 0.0]), C, np.full(3, -INF), U)
    assert (
        guess_nearby(
            problem, Geometry(problem.C), KKTSystem(problem.P, C, np.zeros(3, dtype=np.int8))
        )
        is None
    )
    endless = np.array([0, 0, 1], dtype=np.int8)
    assert guess_nearby(problem, Geometry(problem.C), KKTSystem(problem.P, C, endless)) is None


def test_a_nearby_set_that_is_wrong_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever set is named, the optimum stays: the certificate judges it."""
    rng = np.random.default_rng(1)
    P, A, ones = np.eye(4) + 0.3, rng.normal(size=(3, 4)), np.ones(4)
    steps = [(2 * rng.normal(size=4), -rng.random(3), rng.random(3)) for _ in range(20)]
    honest, deceived = Referee(P, A, -ones, ones), Referee(P, A, -ones, ones)
    known = [honest.certify(*step) for step in steps]

    def lie(problem: JointQP, geometry: Geometry, system: KKTSystem) -> Signs:
        return rng.integers(-1, 2, 7).astype(np.int8)

    monkeypatch.setattr(referee, "guess_nearby", lie)
    for step, optimum in zip(steps, known, strict=True):
        found = deceived.certify(*step)
        assert found.kind == optimum.kind == "linear"
        assert np.abs(found.z - optimum.z).max() <= found.bound + optimum.bound <= 1e-12


def test_sets_that_change_by_little_need_no_guesser(monkeypatch: pytest.MonkeyPatch) -> None:
    """Along a path that crosses limits every set is found from the one before."""
    monkeypatch.setattr(referee, "guesses", lambda problem: pytest.fail("a guesser was asked"))
    n, none = 5, np.zeros(0)
    steady = Referee(np.eye(n) + 0.1, np.zeros((0, n)), -np.ones(n), np.ones(n))
    sets = set()
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        optimum = steady.certify(3.0 * np.sin(angle + np.arange(n)), none, none)
        assert optimum.kind == "linear" and optimum.bound <= 1e-15
        sets.add(np.sign(optimum.y_box).tobytes())
    assert len(sets) >= 10


def test_any_memory_of_the_vectors_is_taken() -> None:
    """Vectors that may not be written to, or are every second number of others, compile nothing."""
    P, none, ones = np.eye(3), np.zeros((0, 3)), np.ones(3)
    plain = Referee(P, none, -ones, ones).certify(np.array([-2.0, 0.5, 0.0]), ones[:0], ones[:0])
    compiled = len(classify_limits.signatures), len(linear_kernel.signatures)
    q = np.array([-2.0, 9.0, 0.5, 9.0, 0.0, 9.0])
    q.setflags(write=False)
    strided = Referee(P, none, -ones, ones).certify(q[::2], ones[:0], ones[:0])
    assert (strided.z == plain.z).all() and strided.kind == plain.kind == "linear"
    assert compiled == (len(classify_limits.signatures), len(linear_kernel.signatures))
