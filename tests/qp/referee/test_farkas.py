"""Certificates of infeasibility and unboundedness: true ones found, false ones refused."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee import referee
from dpbench.qp.referee.farkas import (
    find_farkas_vector,
    find_unbounded_direction,
    is_direction_proof_of_unboundedness,
    is_farkas_vector_proof,
)
from dpbench.qp.referee.referee import (
    Referee,
    certify,
    is_infeasibility_or_unboundedness_claim_true,
    measure_first_move_and_plan_errors_of_many,
)
from dpbench.qp.solution import Solution, Status

INF = np.inf
seeds = st.integers(0, 2**32 - 1)


def _infeasible(seed: int, n: int, m: int, boxed: bool) -> tuple[QuadraticProgram, np.ndarray]:
    """A problem refuted by a known vector y of small integers, by a margin of 1/8."""
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (m, n)).astype(float)
    y = rng.choice([-2.0, -1.0, 1.0, 2.0], m)
    y[-1] = 1.0
    ub = np.full(n, 1.0 if boxed else INF)
    if not boxed:
        A[-1] = -y[:-1] @ A[:-1]
    width = np.where(rng.random(m) < 0.5, INF, 64.0)
    limit = rng.integers(-16, 17, m) / 8
    others = float(y[:-1] @ limit[:-1]) + (float(np.abs(y @ A).sum()) if boxed else 0.0)
    limit[-1] = -others - 0.125
    u = np.where(y > 0, limit, limit + width)
    l = np.where(y > 0, limit - width, limit)  # noqa: E741 - as in QuadraticProgram
    return QuadraticProgram(np.eye(n), rng.normal(size=n), A, l, u, -ub, ub), y


@pytest.mark.slow
@settings(max_examples=80, derandomize=True, deadline=None)
@given(seeds, st.integers(1, 6), st.integers(2, 7), st.booleans())
def test_infeasible_problems_are_recognised(seed: int, n: int, m: int, boxed: bool) -> None:
    qp, y = _infeasible(seed, n, m, boxed)
    assert is_farkas_vector_proof(qp, y, -(y @ qp.A))
    optimum = certify(qp)
    assert optimum.kind == "infeasible"
    assert is_farkas_vector_proof(qp, optimum.y, optimum.y_box)
    assert np.isnan(optimum.z).all()
    assert np.isnan(
        measure_first_move_and_plan_errors_of_many(np.zeros((1, n)), [optimum], 0)
    ).all()


@pytest.mark.slow
@settings(max_examples=80, derandomize=True, deadline=None)
@given(seeds, st.integers(1, 5), st.integers(1, 6))
def test_no_vector_refutes_a_feasible_problem(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (m, n)).astype(float)
    z = rng.integers(-8, 9, n) / 8
    free = np.where(rng.random((4, max(m, n))) < 0.3, INF, 0.0)
    row, box = (A @ z - free[0, :m], A @ z + free[1, :m]), (z - free[2, :n], z + free[3, :n])
    qp = QuadraticProgram(np.eye(n), rng.normal(size=n), A, *row, *box)
    assert find_farkas_vector(qp) is None
    for _ in range(10):
        y = rng.integers(-3, 4, m).astype(float)
        assert not is_farkas_vector_proof(qp, y, -(y @ A))
        assert not is_farkas_vector_proof(qp, y + 1e-9 * rng.normal(size=m), -(y @ A))


@settings(max_examples=40, derandomize=True, deadline=None)
@given(seeds)
def test_false_vectors_are_refused(seed: int) -> None:
    qp, y = _infeasible(seed, 3, 4, boxed=True)
    y_box = -(y @ qp.A)
    wrong = [(-y, -y_box), (y, y_box + 1.0), (0.0 * y, 0.0 * y_box), (y[:2], y_box)]
    wrong += [(np.full(4, np.nan), y_box), (y, np.full(3, np.nan))]
    assert not any(is_farkas_vector_proof(qp, *vector) for vector in wrong)


def test_vector_must_balance_to_the_last_bit_on_infinite_bounds() -> None:
    A = np.array([[0.1, 1.0], [-0.1, -1.0]])
    free = np.full(2, INF)
    qp = QuadraticProgram(np.eye(2), [0.0, 0.0], A, [-INF] * 2, [1.0, -2.0], -free, free)
    assert is_farkas_vector_proof(qp, np.array([1.0, 1.0]), np.zeros(2))
    assert not is_farkas_vector_proof(qp, np.array([1.0, 1.0 + 2.0**-52]), np.zeros(2))


def test_infinite_limits_cannot_be_named() -> None:
    A = np.array([[1.0]])
    qp = QuadraticProgram(np.eye(1), [0.0], A, [3.0], [INF], [-1.0], [1.0])
    assert is_farkas_vector_proof(qp, np.array([-1.0]), np.array([1.0]))
    assert not is_farkas_vector_proof(qp, np.array([1.0]), np.array([-1.0]))


@pytest.mark.parametrize("limit", [0.3, 1.0, 7.7])
def test_feasible_by_one_point_and_infeasible_by_one_bit(limit: float) -> None:
    uppers = limit, np.nextafter(limit, 0.0), limit * (1.0 - 1e-13)
    row = np.eye(1), [limit], [INF], [-10.0]
    qps = [QuadraticProgram(np.eye(1), [1.0], *row, [upper]) for upper in uppers]
    feasible, rounded, empty = (certify(qp) for qp in qps)
    assert abs(feasible.z[0] - limit) <= feasible.bound <= 1e-12
    assert (rounded.kind, empty.kind) == ("undecided", "infeasible")
    assert is_farkas_vector_proof(qps[1], rounded.y, rounded.y_box)
    assert is_farkas_vector_proof(qps[2], empty.y, empty.y_box)


def _claim(qp: QuadraticProgram, status: Status) -> bool:
    return is_infeasibility_or_unboundedness_claim_true(
        qp, Solution.without_point(qp.n, qp.m, status), certify(qp)
    )


def test_a_false_infeasible_is_as_wrong_as_a_false_solved() -> None:
    empty, y = _infeasible(1, 3, 4, boxed=True)
    full = replace(empty, l=empty.l - 99.0, u=empty.u + 99.0)
    assert _claim(empty, Status.PRIMAL_INFEASIBLE)
    assert not _claim(full, Status.PRIMAL_INFEASIBLE)
    assert not _claim(full, Status.DUAL_INFEASIBLE)
    assert not _claim(empty, Status.SOLVED)
    forged = Solution(Status.PRIMAL_INFEASIBLE, np.zeros(3), y, -(y @ empty.A))
    assert not is_infeasibility_or_unboundedness_claim_true(full, forged, certify(full))
    assert is_infeasibility_or_unboundedness_claim_true(empty, forged, certify(full))


def test_unbounded_problems() -> None:
    P, free = np.diag([1.0, 0.0, 0.0]), np.full(3, INF)
    A = np.array([[0.0, 1.0, -3.0]])
    q = np.array([0.0, -1.0, 0.0])
    open_qp = QuadraticProgram(P, q, A, [-1.0], [1.0], -free, free)
    d = find_unbounded_direction(open_qp)
    assert d is not None
    assert is_direction_proof_of_unboundedness(open_qp, d)
    assert is_direction_proof_of_unboundedness(open_qp, np.array([0.0, 3.0, 1.0]))
    for wrong in ([0.0, -3.0, -1.0], [1.0, 3.0, 1.0], [0.0, 1.0, 0.0], [0.0, 3.0, np.nan]):
        assert not is_direction_proof_of_unboundedness(open_qp, np.array(wrong))
    assert _claim(open_qp, Status.DUAL_INFEASIBLE)
    closed = QuadraticProgram(P, q, A, [-1.0], [1.0], -free, np.full(3, 5.0))
    assert find_unbounded_direction(closed) is None
    assert not is_direction_proof_of_unboundedness(closed, np.array([0.0, 3.0, 1.0]))
    assert not _claim(closed, Status.DUAL_INFEASIBLE)


def _opposed(excess: float) -> tuple[np.ndarray, np.ndarray]:
    """l and u of z_1 + z_2 ≤ 1, z_1 + z_2 ≥ 1 + excess and a row that moves with it."""
    return np.array([-INF, 1.0 + excess, -INF]), np.array([1.0, INF, 9.0 + excess])


BOX = np.full(2, 4.0)
OPPOSED = np.eye(2), np.array([[1.0, 1.0], [1.0, 1.0], [1.0, -1.0]]), -BOX, BOX


def test_the_vector_of_an_earlier_problem_is_tried_first(monkeypatch: pytest.MonkeyPatch) -> None:
    count = Mock(wraps=find_farkas_vector)
    monkeypatch.setattr(referee, "find_farkas_vector", count)
    steady, q = Referee(*OPPOSED), np.array([-3.0, 0.5])
    for excess in (0.5, 0.25, -0.25, 1.0, 2.0):
        l, u = _opposed(excess)  # noqa: E741 - as in QuadraticProgram
        optimum = steady.certify_vectors(q, l, u)
        assert optimum.kind == ("infeasible" if excess > 0.0 else "linear")
        if excess > 0.0:
            qp = QuadraticProgram(OPPOSED[0], q, OPPOSED[1], l, u, *OPPOSED[2:])
            assert is_farkas_vector_proof(qp, optimum.y, optimum.y_box)
    count.assert_called_once()


@pytest.mark.parametrize("excess", [2.0**-52, 1e-12, 0.0, -1e-12])
def test_an_earlier_vector_changes_no_verdict(excess: float) -> None:
    q = np.array([-3.0, 0.5])
    seasoned, fresh = Referee(*OPPOSED), Referee(*OPPOSED)
    assert seasoned.certify_vectors(q, *_opposed(0.5)).kind == "infeasible"
    later, known = (
        seasoned.certify_vectors(q, *_opposed(excess)),
        fresh.certify_vectors(q, *_opposed(excess)),
    )
    assert later.kind == known.kind
    assert np.array_equal(later.z, known.z, equal_nan=True) or later.bound < 1e-9


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None)
@given(seeds, st.integers(1, 5), st.integers(2, 6), st.booleans())
def test_an_earlier_vector_proves_no_other_problem(seed: int, n: int, m: int, boxed: bool) -> None:
    rng = np.random.default_rng(seed)
    qp, _ = _infeasible(seed, n, m, boxed)
    seasoned = Referee(qp.P, qp.A, qp.lb, qp.ub)
    assert seasoned.certify_vectors(qp.q, qp.l, qp.u).kind == "infeasible"
    for _ in range(3):
        shift = rng.integers(-8, 9, m) / 4
        l, u = qp.l + np.minimum(shift, 0.0), qp.u + np.maximum(shift, 0.0)  # noqa: E741 - as above
        later = seasoned.certify_vectors(qp.q, l, u)
        known = Referee(qp.P, qp.A, qp.lb, qp.ub).certify_vectors(qp.q, l, u)
        assert (later.kind == "infeasible") is (known.kind == "infeasible")
