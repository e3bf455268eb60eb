"""Residuals that cannot be fooled, and the verdict built on them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify, measure_first_move_and_plan_errors_of_many
from dpbench.qp.residuals import (
    TRUE_TOL,
    Residuals,
    are_answers_correct,
    fit_row_and_bound_multipliers,
    residuals,
)
from dpbench.qp.solution import Solution, Status

INF = np.inf


def _qp(n: int = 6, m: int = 3, seed: int = 0) -> QuadraticProgram:
    rng = np.random.default_rng(seed)
    B, A, q = rng.normal(size=(n, n)), rng.normal(size=(m, n)), 4.0 * rng.normal(size=n)
    row, box = np.ones(m), np.ones(n)
    return QuadraticProgram(B.T @ B + np.eye(n), q, A, -row, row, -box, box, 2)


def _answer(z: NDArray[np.float64], y: object, y_box: object) -> Solution:
    return Solution(Status.SOLVED, z, np.asarray(y, dtype=float), np.asarray(y_box, dtype=float))


def _exact(qp: QuadraticProgram) -> Solution:
    optimum = certify(qp)
    return _answer(optimum.z, optimum.y, optimum.y_box)


def _true(qp: QuadraticProgram, answer: Solution, tol: float = 1e-3) -> bool:
    plan = _errors(answer.z, certify(qp), qp.block)[1]
    return bool(are_answers_correct(qp.q[np.newaxis], residuals(qp, answer), plan, tol)[0])


def _errors(
    z: NDArray[np.float64], optimum: Optimum, block: int, moves: int = 0
) -> tuple[float, float]:
    """The largest errors of first move and plan of one answer."""
    move, plan = measure_first_move_and_plan_errors_of_many(z[np.newaxis], [optimum], block, moves)
    return float(move[0]), float(plan[0])


def _line(q: float, low: float, high: float, box: float = INF) -> QuadraticProgram:
    """min ½x² + qx, low ≤ x ≤ high by a row, |x| ≤ box."""
    one = np.ones((1, 1))
    return QuadraticProgram(one, [q], one, [low], [high], [-box], [box])


def _scalar(x: float, y: float, y_box: float = 0.0) -> Solution:
    return _answer(np.array([x]), [y], [y_box])


def test_a_multiplier_of_the_wrong_sign_is_an_error_of_full_size() -> None:
    """min ½x² − x, x ≤ 2 at x = 2 with multiplier −1."""
    qp, answer = _line(-1.0, -INF, 2.0), _scalar(2.0, -1.0)
    found = residuals(qp, answer)
    assert (found.primal, found.dual, found.complementarity) == (0.0, 0.0, 1.0)
    assert found.gap >= 1.0
    assert not _true(qp, answer)
    assert certify(qp).z[0] == 1.0


@pytest.mark.parametrize("far", [1.5, -3.0])
def test_a_multiplier_of_the_far_limit_is_an_error_of_full_size(far: float) -> None:
    assert residuals(_line(-1.0, far, 2.0), _scalar(2.0, -1.0)).complementarity >= 1.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("row", [True, False])
def test_a_multiplier_on_an_infinite_limit_counts_in_full(sign: float, row: bool) -> None:
    answer = _scalar(0.0, sign * 3.0) if row else _scalar(0.0, 0.0, sign * 3.0)
    found = residuals(_line(-sign * 3.0, -INF, INF), answer)
    assert (found.dual, found.complementarity) == (0.0, 3.0)
    assert found.gap >= 3.0


@pytest.mark.parametrize("bad", [np.nan, INF, -INF])
@pytest.mark.parametrize(("which", "entry"), [("z", 0), ("z", 5), ("y", -1), ("y_box", -1)])
def test_a_non_finite_number_makes_every_residual_infinite_that_depends_on_it(
    bad: float, which: str, entry: int
) -> None:
    qp = _qp()
    exact = _exact(qp)
    getattr(exact, which)[entry] = bad
    found = residuals(qp, exact)
    assert (found.dual, found.complementarity, found.gap) == (INF, INF, INF)
    assert found.primal == INF if which == "z" else found.primal <= 1e-12
    assert not _true(qp, exact)


def test_products_that_overflow_give_infinite_residuals() -> None:
    qp = _qp()
    exact = _exact(qp)
    exact.z[0] = 1.7e308
    found = residuals(qp, exact)
    assert (found.dual, found.gap) == (INF, INF)
    assert found.primal > 1e300
    assert not _true(qp, exact)


def test_nan_in_the_problem_is_never_a_residual_of_zero() -> None:
    qp = _qp()
    exact = _exact(qp)
    for name, residual in (("u", "primal"), ("q", "dual")):
        vector = getattr(qp, name).copy()
        vector[0] = np.nan
        disturbed = replace(qp, **{name: vector})
        assert getattr(residuals(disturbed, exact), residual) == INF
        assert certify(disturbed).kind == "none"


@pytest.mark.parametrize("seed", range(8))
def test_formulas_term_by_term(seed: int) -> None:
    qp = _qp(seed=seed)
    rng = np.random.default_rng(seed)
    z, y, y_box = rng.normal(size=qp.n), rng.normal(size=qp.m), rng.normal(size=qp.n)
    found = residuals(qp, _answer(z, y, y_box))
    rows = list(
        zip(
            np.concatenate((qp.A @ z, z)),
            *qp.stack_row_and_bound_limits(),
            [*y, *y_box],
            strict=True,
        )
    )
    r = [sum(qp.P[i] * z) + qp.q[i] + sum(qp.A[:, i] * y) + y_box[i] for i in range(qp.n)]
    errors = []
    for value, lower, upper, lam in rows:
        near, far = (upper - value, value - lower) if lam > 0 else (value - lower, upper - value)
        least = 1.0 if abs(near) > abs(far) else 0.0
        errors.append(abs(lam) * max(abs(near), least))
    # Sums of some 40 terms of order 10.
    rounding = {"rel": 1e-12, "abs": 1e-12}
    primal = max(0.0, *(max(lower - value, value - upper) for value, lower, upper, _ in rows))
    assert found.primal == pytest.approx(primal, **rounding)
    assert found.dual == pytest.approx(max(map(abs, r)), **rounding)
    assert found.complementarity == pytest.approx(max(errors), **rounding)
    assert found.gap == pytest.approx(sum(errors) + abs(z @ np.array(r)), **rounding)


@pytest.mark.parametrize("seed", range(5))
def test_exact_answer_is_true_at_every_level(seed: int) -> None:
    qp = _qp(seed=seed)
    assert all(_true(qp, _exact(qp), tol) for tol in (1e-3, 1e-4, 1e-6))


@pytest.mark.parametrize("seed", range(5))
def test_status_is_not_looked_at(seed: int) -> None:
    qp = _qp(seed=seed)
    exact = _exact(qp)
    claims = [Solution(s, exact.z, exact.y, exact.y_box) for s in Status]
    assert len({residuals(qp, claim) for claim in claims}) == 1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("attack", ["moved", "swapped", "no multipliers", "other problem", "zero"])
def test_attacks_are_found_false(attack: str, seed: int) -> None:
    qp = _qp(seed=seed)
    exact = _exact(qp)
    # Limits 10 % tighter: the optimum moves by more than the 1e-2 that would be forgiven.
    tighter = {name: 0.9 * getattr(qp, name) for name in ("l", "u", "lb", "ub")}
    answers = {
        "moved": _answer(exact.z + 0.02 * np.eye(qp.n)[seed], exact.y, exact.y_box),
        "swapped": _answer(exact.z, -exact.y, -exact.y_box),
        "no multipliers": _answer(exact.z, 0.0 * exact.y, 0.0 * exact.y_box),
        "other problem": _exact(replace(qp, **tighter)),
        "zero": _answer(0.0 * exact.z, exact.y, exact.y_box),
    }
    assert not _true(qp, answers[attack])


@pytest.mark.parametrize("seed", range(5))
def test_best_multipliers_do_not_excuse_a_wrong_point(seed: int) -> None:
    qp = _qp(seed=seed)
    z = 0.9 * certify(qp).z
    y, y_box = fit_row_and_bound_multipliers(qp, z, 1e-6)
    assert residuals(qp, _answer(z, y, y_box)).dual > 1e-3 * (1.0 + np.abs(qp.q).max())


def test_best_multipliers_name_finite_limits_only() -> None:
    eye = np.eye(2)
    qp = QuadraticProgram(eye, [-3.0, 3.0], eye, [-INF, 1.0], [1.0, 1.0], [-INF] * 2, [INF] * 2)
    y, y_box = fit_row_and_bound_multipliers(qp, np.array([1.0, 1.0]), 1e-6)
    # Non-negative least squares of two orthogonal columns: exact up to a few roundings.
    assert y == pytest.approx([2.0, -4.0], rel=1e-14)
    assert not y_box.any()


@pytest.mark.parametrize("bad", [INF, np.nan])
def test_multipliers_of_no_point_are_not_numbers(bad: float) -> None:
    qp = _qp()
    y, y_box = fit_row_and_bound_multipliers(qp, np.append(np.zeros(qp.n - 1), bad), 1e-6)
    assert (y.shape, y_box.shape) == ((qp.m,), (qp.n,))
    assert np.isnan(y).all() and np.isnan(y_box).all()


def test_error_of_move_and_plan() -> None:
    qp = _qp()
    optimum = certify(qp)
    z = optimum.z.copy()
    z[3] += 0.5
    assert _errors(z, optimum, 2) == (0.0, pytest.approx(0.5, rel=1e-14))
    assert _errors(z, optimum, 0)[0] == _errors(z, optimum, 0)[1]
    z[5] = np.nan
    assert _errors(z, optimum, 2) == (INF, INF)


def test_slacks_are_no_error_of_a_move_or_a_plan() -> None:
    qp = _qp()
    optimum = certify(qp)
    z = optimum.z.copy()
    z[:6] += [0.25, 7.0, -0.5, 8.0, 0.125, 9.0]
    rounding = pytest.approx(0.25, rel=1e-14), pytest.approx(0.5, rel=1e-14)
    assert _errors(z, optimum, 2, moves=1) == rounding
    assert _errors(z, optimum, 2, moves=2) == _errors(z, optimum, 2)
    assert _errors(z, optimum, 0, moves=1) == (rounding[0], rounding[0])
    assert _errors(z, optimum, 0, moves=3) == _errors(z, optimum, 3)[:1] * 2
    z[1] = np.nan
    assert _errors(z, optimum, 2, moves=1) == (INF, INF)


@pytest.mark.parametrize(("off_middle", "error"), [(0.45e-6, 0.5e-3 + 0.45e-6), (0.55e-6, 1.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_multiplier_may_name_either_limit_of_an_equality_like_row(
    sign: float, off_middle: float, error: float
) -> None:
    """On a row 1e-3 wide the far limit counts in full from 1e-6 nearer to the other one on.

    z is `off_middle` beyond the middle, so the other limit is nearer by twice as much.
    """
    found = residuals(_line(0.0, -0.5e-3, 0.5e-3), _scalar(-sign * off_middle, sign))
    assert found.complementarity == pytest.approx(error, rel=1e-9)


@pytest.mark.parametrize(("high", "error"), [(4.0, 8.0), (0.5, 2.0)])
def test_the_slack_of_the_far_limit_counts_as_at_least_one(high: float, error: float) -> None:
    """0.25 away from the near limit, with a multiplier of 2 that names the other."""
    assert residuals(_line(0.0, -0.25, high), _scalar(0.0, 2.0)).complementarity == error


def test_all_four_residuals_by_hand() -> None:
    """Two variables, one row, a point outside a bound and a dual residual. z = (2, −1)."""
    P, A = np.diag([2.0, 3.0]), np.array([[3.0, 4.0]])
    qp = QuadraticProgram(P, [1.0, -2.0], A, [-1.0], [5.0], [-9.0, -1.0], [1.5, 9.0])
    found = residuals(qp, _answer(np.array([2.0, -1.0]), [2.0], [1.0, -2.0]))
    # |y|·slack: 2·3, 1·0.5, 2·0; and |zᵀr| = 24 − 1.
    assert found == Residuals(0.5, 12.0, 6.0, 6.5 + 23.0)


@pytest.mark.parametrize("which", ["primal", "dual", "plan"])
def test_the_bounds_of_a_true_answer(which: str) -> None:
    """Each bound holds at its value and not beyond: 1e-3, 1e-3·(1 + 3) and 1e-2; NaN is beyond."""
    one = np.ones((2, 2))
    qp = QuadraticProgram(np.eye(2), [1.0, -3.0], one, -one[0], one[0], -one[0], one[0])
    bound = {"primal": 1e-3, "dual": 4e-3, "plan": 1e-2}

    def is_true_at(value: float) -> bool:
        of = dict.fromkeys(bound, 0.0) | {which: value}
        found = Residuals(of["primal"], of["dual"], INF, INF)
        return bool(are_answers_correct(qp.q[np.newaxis], found, of["plan"], TRUE_TOL)[0])

    assert is_true_at(bound[which])
    assert not is_true_at(bound[which] * (1.0 + 1e-9))
    assert not is_true_at(np.nan)
    assert not is_true_at(INF)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("slack", "touched"), [(1.0, True), (1.01, False)])
@pytest.mark.parametrize(("row", "box"), [(3.0, INF), (INF, 3.0)])
def test_a_point_touches_a_limit_within_the_tolerance(
    side: float, slack: float, touched: bool, row: float, box: float
) -> None:
    """A limit of ±3 is met to within ¼·(1 + 3), that included, by rows and by bounds.

    The gradient Pz + q is −side there, so the multiplier of a limit that is met is `side`.
    """
    z = side * (3.0 - slack)
    found = np.concatenate(
        fit_row_and_bound_multipliers(_line(-side - z, -row, row, box), np.array([z]), 0.25)
    )
    expected = [side if touched else 0.0, 0.0]
    assert found == pytest.approx(expected if row == 3.0 else expected[::-1], rel=1e-14)


def test_a_multiplier_never_pulls_towards_the_inside() -> None:
    # At z = 3 the cost falls towards the inside: 3 + 1 > 0.
    assert fit_row_and_bound_multipliers(_line(1.0, -2.0, 3.0), np.array([3.0]), 1e-6) == (0.0, 0.0)
    # Both limits met: either sign, so the multiplier is −(2 + 1).
    y, y_box = fit_row_and_bound_multipliers(_line(1.0, 2.0, 2.0), np.array([2.0]), 1e-6)
    assert (y, y_box) == (pytest.approx([-3.0]), pytest.approx([0.0]))


def test_sums_that_overflow_are_errors_without_end() -> None:
    eye, zero, free = np.zeros((2, 2)), np.zeros(2), np.full(2, INF)
    qp = QuadraticProgram(eye, zero, eye, -free, free, -free, free)
    large = np.full(2, 1.7e308)
    assert residuals(qp, _answer(large, zero, zero)) == Residuals(INF, INF, INF, INF)
    qp = QuadraticProgram(eye, zero, eye, zero, zero, -free, free)
    assert residuals(qp, _answer(zero, zero, zero)) == Residuals(0.0, 0.0, 0.0, 0.0)
    assert residuals(qp, _answer(zero, large, zero)) == Residuals(0.0, INF, INF, INF)
