"""Residuals that cannot be fooled, and the verdict built on them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify, error_of
from dpbench.qp.residuals import Residuals, best_multipliers, is_true, residuals
from dpbench.qp.solution import Solution, Status

INF = np.inf


def _qp(n: int = 6, m: int = 3, seed: int = 0) -> QuadraticProgram:
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(n, n))
    A = rng.normal(size=(m, n))
    ones = np.ones
    return QuadraticProgram(
        B.T @ B + np.eye(n), 4.0 * rng.normal(size=n), A, -ones(m), ones(m), -ones(n), ones(n), 2
    )


def _answer(z: NDArray[np.float64], y: object, y_box: object) -> Solution:
    return Solution(Status.SOLVED, z, np.asarray(y, dtype=float), np.asarray(y_box, dtype=float))


def _exact(qp: QuadraticProgram) -> Solution:
    optimum = certify(qp)
    return _answer(optimum.z, optimum.y, optimum.y_box)


def _true(qp: QuadraticProgram, answer: Solution, tol: float = 1e-3) -> bool:
    plan = error_of(answer.z, certify(qp), qp.block)[1]
    return is_true(qp, residuals(qp, answer), plan, tol)


def test_multiplier_of_the_wrong_sign() -> None:
    """Trap 1: min ½x² − x, x ≤ 2 at x = 2 with multiplier −1 is an error of full size."""
    one = np.ones((1, 1))
    qp = QuadraticProgram(one, [-1.0], one, [-INF], [2.0], [-INF], [INF])
    found = residuals(qp, _answer(np.array([2.0]), [-1.0], [0.0]))
    assert (found.primal, found.dual) == (0.0, 0.0)
    assert found.complementarity == 1.0
    assert found.gap >= 1.0
    assert not _true(qp, _answer(np.array([2.0]), [-1.0], [0.0]))
    assert certify(qp).z[0] == 1.0


def test_multiplier_naming_the_far_limit() -> None:
    """A multiplier that names the far one of two limits is an error of full size."""
    one = np.ones((1, 1))
    for far in (1.5, -3.0):
        qp = QuadraticProgram(one, [-1.0], one, [far], [2.0], [-INF], [INF])
        found = residuals(qp, _answer(np.array([2.0]), [-1.0], [0.0]))
        assert found.complementarity >= 1.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("row", [True, False])
def test_multiplier_on_an_infinite_limit(sign: float, row: bool) -> None:
    """Trap 2: a multiplier whose sign names an infinite limit counts in full."""
    one = np.ones((1, 1))
    qp = QuadraticProgram(one, [-sign * 3.0], one, [-INF], [INF], [-INF], [INF])
    y, y_box = ([sign * 3.0], [0.0]) if row else ([0.0], [sign * 3.0])
    found = residuals(qp, _answer(np.zeros(1), y, y_box))
    assert found.dual == 0.0
    assert found.complementarity == 3.0
    assert found.gap >= 3.0


@pytest.mark.parametrize("bad", [np.nan, INF, -INF])
@pytest.mark.parametrize("entry", [0, 5])
def test_non_finite_iterate(bad: float, entry: int) -> None:
    """Trap 3: NaN or Inf in one entry of z makes every residual inf."""
    qp = _qp()
    exact = _exact(qp)
    exact.z[entry] = bad
    found = residuals(qp, exact)
    assert found == Residuals(INF, INF, INF, INF)
    assert not _true(qp, exact)


def test_overflow_of_a_diverged_iterate() -> None:
    """A finite iterate whose products overflow gives infinite residuals, not an exception."""
    qp = _qp()
    exact = _exact(qp)
    exact.z[0] = 1.7e308
    found = residuals(qp, exact)
    assert (found.dual, found.gap) == (INF, INF)
    assert found.primal > 1e300
    assert not _true(qp, exact)


@pytest.mark.parametrize("bad", [np.nan, INF, -INF])
def test_non_finite_multiplier(bad: float) -> None:
    """NaN or Inf in one multiplier makes all residuals inf that depend on it."""
    qp = _qp()
    for which in ("y", "y_box"):
        exact = _exact(qp)
        getattr(exact, which)[-1] = bad
        found = residuals(qp, exact)
        assert (found.dual, found.complementarity, found.gap) == (INF, INF, INF)
        assert found.primal <= 1e-12
        assert not _true(qp, exact)


def test_nan_in_the_problem_is_never_a_residual_of_zero() -> None:
    """NaN in the limits or the cost makes the residual it touches inf."""
    qp = _qp()
    exact = _exact(qp)
    limits, cost = qp.u.copy(), qp.q.copy()
    limits[0], cost[0] = np.nan, np.nan
    disturbed = QuadraticProgram(qp.P, qp.q, qp.A, qp.l, limits, qp.lb, qp.ub)
    assert residuals(disturbed, exact).primal == INF
    disturbed = QuadraticProgram(qp.P, cost, qp.A, qp.l, qp.u, qp.lb, qp.ub)
    assert residuals(disturbed, exact).dual == INF
    assert certify(disturbed).kind == "none"


@pytest.mark.parametrize("seed", range(8))
def test_formulas_term_by_term(seed: int) -> None:
    """At any point the residuals are those of the definitions, evaluated entry by entry."""
    qp = _qp(seed=seed)
    rng = np.random.default_rng(seed)
    z, y, y_box = rng.normal(size=qp.n), rng.normal(size=qp.m), rng.normal(size=qp.n)
    found = residuals(qp, _answer(z, y, y_box))
    rows = [(qp.A[i] @ z, qp.l[i], qp.u[i], y[i]) for i in range(qp.m)]
    rows += [(z[i], qp.lb[i], qp.ub[i], y_box[i]) for i in range(qp.n)]
    r = [
        sum(qp.P[i, j] * z[j] for j in range(qp.n))
        + qp.q[i]
        + sum(qp.A[j, i] * y[j] for j in range(qp.m))
        + y_box[i]
        for i in range(qp.n)
    ]
    errors = []
    for value, lower, upper, lam in rows:
        near, far = (upper - value, value - lower) if lam > 0 else (value - lower, upper - value)
        full = abs(near) > abs(far)
        errors.append(abs(lam) * (max(abs(near), 1.0) if full else abs(near)))
    # Sums of some 40 terms of order 10.
    rounding = {"rel": 1e-12, "abs": 1e-12}
    primal = max(0.0, *(max(lower - value, value - upper) for value, lower, upper, _ in rows))
    assert found.primal == pytest.approx(primal, **rounding)
    assert found.dual == pytest.approx(max(map(abs, r)), **rounding)
    assert found.complementarity == pytest.approx(max(errors), **rounding)
    assert found.gap == pytest.approx(sum(errors) + abs(z @ np.array(r)), **rounding)


@pytest.mark.parametrize("seed", range(5))
def test_exact_answer_is_true_at_every_level(seed: int) -> None:
    """The certified optimum with its multipliers is true at 1e-3, 1e-4 and 1e-6."""
    qp = _qp(seed=seed)
    assert all(_true(qp, _exact(qp), tol) for tol in (1e-3, 1e-4, 1e-6))


@pytest.mark.parametrize("seed", range(5))
def test_status_is_not_looked_at(seed: int) -> None:
    """The residuals of an answer are the same whatever its solver claims."""
    qp = _qp(seed=seed)
    exact = _exact(qp)
    claims = [Solution(s, exact.z, exact.y, exact.y_box) for s in Status]
    assert len({residuals(qp, claim) for claim in claims}) == 1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("attack", ["moved", "swapped", "no multipliers", "other problem", "zero"])
def test_attacks_are_found_false(attack: str, seed: int) -> None:
    """A moved point, swapped signs, missing multipliers or another problem's optimum is false."""
    qp = _qp(seed=seed)
    exact = _exact(qp)
    if attack == "moved":
        exact.z[seed] += 0.02
    elif attack == "swapped":
        exact = _answer(exact.z, -exact.y, -exact.y_box)
    elif attack == "no multipliers":
        exact = _answer(exact.z, 0.0 * exact.y, 0.0 * exact.y_box)
    elif attack == "other problem":
        # Limits 10 % tighter: the optimum moves by more than the 1e-2 that would be forgiven.
        limits = (0.9 * array for array in (qp.l, qp.u, qp.lb, qp.ub))
        other = QuadraticProgram(qp.P, qp.q, qp.A, *limits)
        exact = _exact(other)
    else:
        exact = _answer(0.0 * exact.z, exact.y, exact.y_box)
    assert not _true(qp, exact)


@pytest.mark.parametrize("seed", range(5))
def test_best_multipliers_do_not_excuse_a_wrong_point(seed: int) -> None:
    """The best multipliers of a point that is no optimum leave a dual residual that tells."""
    qp = _qp(seed=seed)
    z = 0.9 * certify(qp).z
    y, y_box = best_multipliers(qp, z, 1e-6)
    assert residuals(qp, _answer(z, y, y_box)).dual > 1e-3 * (1.0 + np.abs(qp.q).max())


def test_best_multipliers_name_finite_limits_only() -> None:
    """Multipliers are zero where a point touches nothing, and NaN where it is no point."""
    eye = np.eye(2)
    qp = QuadraticProgram(eye, [-3.0, 3.0], eye, [-INF, 1.0], [1.0, 1.0], [-INF] * 2, [INF] * 2)
    y, y_box = best_multipliers(qp, np.array([1.0, 1.0]), 1e-6)
    # Non-negative least squares of two orthogonal columns: exact up to a few roundings.
    assert y == pytest.approx([2.0, -4.0], rel=1e-14)
    assert not y_box.any()
    assert np.isnan(best_multipliers(qp, np.array([np.nan, 0.0]), 1e-6)[0]).all()


def test_error_of_move_and_plan() -> None:
    """error_move covers the first block, error_plan everything; no point is inf."""
    qp = _qp()
    optimum = certify(qp)
    z = optimum.z.copy()
    z[3] += 0.5
    assert error_of(z, optimum, 2) == (0.0, pytest.approx(0.5, rel=1e-14))
    assert error_of(z, optimum, 0)[0] == error_of(z, optimum, 0)[1]
    z[5] = np.nan
    assert error_of(z, optimum, 2) == (INF, INF)


def test_slacks_are_no_error_of_a_move_or_a_plan() -> None:
    """With `moves`, only the first variables of every block count, in the first block and in all,
    which are one block where `block` is 0; a slack that is not finite still makes the answer
    useless."""
    qp = _qp()
    optimum = certify(qp)
    z = optimum.z.copy()
    z[:6] += [0.25, 7.0, -0.5, 8.0, 0.125, 9.0]
    rounding = pytest.approx(0.25, rel=1e-14), pytest.approx(0.5, rel=1e-14)
    assert error_of(z, optimum, 2, moves=1) == rounding
    assert error_of(z, optimum, 2, moves=2) == error_of(z, optimum, 2)
    assert error_of(z, optimum, 0, moves=1) == (rounding[0], rounding[0])
    assert error_of(z, optimum, 0, moves=3) == error_of(z, optimum, 3)[:1] * 2
    z[1] = np.nan
    assert error_of(z, optimum, 2, moves=1) == (INF, INF)


@pytest.mark.parametrize(("off_middle", "error"), [(0.45e-6, 0.5e-3 + 0.45e-6), (0.55e-6, 1.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_multiplier_may_name_either_limit_of_an_equality_like_row(
    sign: float, off_middle: float, error: float
) -> None:
    """On a row 1e-3 wide the far limit counts in full from 1e-6 nearer to the other one on.

    z stands `off_middle` beyond the middle, away from the limit that the sign names, so the other
    one is nearer by twice as much; below that the error is the slack to the limit named.
    """
    one = np.ones((1, 1))
    qp = QuadraticProgram(one, [0.0], one, [-0.5e-3], [0.5e-3], [-INF], [INF])
    found = residuals(qp, _answer(np.array([-sign * off_middle]), [sign], [0.0]))
    assert found.complementarity == pytest.approx(error, rel=1e-9)


def test_a_far_slack_beyond_one_counts_in_full() -> None:
    """The slack of a multiplier on the wrong side counts as at least 1, and as itself beyond."""
    one = np.ones((1, 1))
    qp = QuadraticProgram(one, [0.0], one, [-0.25], [4.0], [-INF], [INF])
    answer = _answer(np.zeros(1), [2.0], [0.0])
    assert residuals(qp, answer).complementarity == 8.0
    # A small one does not shrink the error: 0.5 is named, 0.25 is nearer.
    qp = QuadraticProgram(one, [0.0], one, [-0.25], [0.5], [-INF], [INF])
    assert residuals(qp, answer).complementarity == 2.0


def test_all_four_residuals_by_hand() -> None:
    """Two variables, one row, a point outside a bound and a dual residual.

    z = (2, −1): the row 3·2 + 4·(−1) = 2 of [−1, 5] has 3 to its upper limit, which y = 2 names:
    wrong? No: the lower limit is as far. z1 is 0.5 above its bound, z2 on its lower one; y_box =
    (1, −2) names these. r = P z + q + Aᵀy + y_box = (4 + 1 + 6 + 1, −3 − 2 + 8 − 2) = (12, 1).
    """
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
        return is_true(qp, Residuals(of["primal"], of["dual"], INF, INF), of["plan"])

    assert is_true_at(bound[which])
    assert not is_true_at(bound[which] * (1.0 + 1e-9))
    assert not is_true_at(np.nan)
    assert not is_true_at(INF)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("slack", "touched"), [(1.0, True), (1.01, False)])
def test_a_point_touches_a_limit_within_the_tolerance(
    side: float, slack: float, touched: bool
) -> None:
    """A limit of ±3 is met to within ¼·(1 + 3), that included, by rows and by bounds.

    The gradient Pz + q is −side there, so the multiplier of a limit that is met is `side`.
    """
    z = side * (3.0 - slack)
    for of_row in (True, False):
        row, box = ([3.0], [INF]) if of_row else ([INF], [3.0])
        qp = QuadraticProgram(
            np.ones((1, 1)),
            [-side - z],
            np.ones((1, 1)),
            np.negative(row),
            row,
            np.negative(box),
            box,
        )
        multipliers = np.concatenate(best_multipliers(qp, np.array([z]), 0.25))
        expected = [side if touched else 0.0, 0.0]
        assert multipliers == pytest.approx(expected if of_row else expected[::-1], rel=1e-14)


def test_a_multiplier_never_pulls_towards_the_inside() -> None:
    """A gradient that points away from the limit met is not explained by a multiplier."""
    one = np.ones((1, 1))
    qp = QuadraticProgram(one, [1.0], one, [-2.0], [3.0], [-INF], [INF])
    # At z = 3 the cost falls towards the inside: 3 + 1 > 0.
    assert best_multipliers(qp, np.array([3.0]), 1e-6) == (0.0, 0.0)
    # Both limits met: either sign, so the multiplier is −(2 + 1).
    qp = QuadraticProgram(one, [1.0], one, [2.0], [2.0], [-INF], [INF])
    y, y_box = best_multipliers(qp, np.array([2.0]), 1e-6)
    assert (y, y_box) == (pytest.approx([-3.0]), pytest.approx([0.0]))


def test_multipliers_of_no_point_are_not_numbers() -> None:
    """NaN in the length of the rows and of the variables, for inf as for NaN."""
    qp = _qp()
    for bad in (INF, np.nan):
        y, y_box = best_multipliers(qp, np.full(qp.n, bad), 1e-6)
        assert (y.shape, y_box.shape) == ((qp.m,), (qp.n,))
        assert np.isnan(y).all() and np.isnan(y_box).all()


def test_sums_that_overflow_are_errors_without_end() -> None:
    """Each entry is finite and free, and its products are zero: still no answer to trust."""
    eye, zero, free = np.zeros((2, 2)), np.zeros(2), np.full(2, INF)
    qp = QuadraticProgram(eye, zero, eye, -free, free, -free, free)
    large = np.full(2, 1.7e308)
    assert residuals(qp, _answer(large, zero, zero)) == Residuals(INF, INF, INF, INF)
    qp = QuadraticProgram(eye, zero, eye, zero, zero, -free, free)
    assert residuals(qp, _answer(zero, zero, zero)) == Residuals(0.0, 0.0, 0.0, 0.0)
    assert residuals(qp, _answer(zero, large, zero)) == Residuals(0.0, INF, INF, INF)
