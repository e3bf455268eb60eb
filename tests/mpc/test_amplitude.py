"""Policies of the amplitude limits: hard, reachable and soft with an exact penalty."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.optimize import linprog

from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.soft_limits import Penalty
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify
from tests.mpc.conftest import at_sea, random_problem, ship_problem

LOST = np.array([1.0, 0.45, 0.6])
"""Remaining shares of the limits in `thruster_loss`."""
EQUAL = 1e-9
"""The largest difference of two plans called equal, in maximum increments; both are certified to
1e-10 or better."""


def optimum(qp: QuadraticProgram) -> Optimum:
    found = certify(qp)
    assert found.bound < 1e-10
    return found


def blocks(builder: CondensedQP, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moves (N_c, n_u) and slacks (N_c, n_u) of a scaled answer."""
    rows = z.reshape(builder.control.N_c, -1)
    n_u = builder.control.model.n_u
    return rows[:, :n_u], rows[:, n_u:]


def lost_thruster() -> tuple[Any, np.ndarray, Limits]:
    """A robust controller, full sway force applied, and the limits that are left."""
    problem = ship_problem("supply_fs99", N_p=60, N_c=10, robust=True)
    u_prev = np.array([0.0, problem.u_max[1], 0.2 * problem.u_max[2]])
    return problem, u_prev, Limits(problem.u_min * LOST, problem.u_max * LOST)


def test_where_hard_limits_are_feasible_the_soft_plan_is_the_hard_one(case: Any) -> None:
    hard, soft = CondensedQP(case.problem), CondensedQP(case.problem, amplitude="soft")
    assert soft.penalty is not None
    free = np.linalg.solve(hard.P, hard.emit(case.x, case.y_ref, case.u_prev).q)
    span = (case.problem.u_max - case.problem.u_min) / case.problem.du_max
    near = min(1.0, 0.25 * float(span.min()) / np.abs(free).max())
    narrow = Limits(0.5 * case.problem.u_min, 0.5 * case.problem.u_max)
    for u_prev, limits in ((case.u_prev, None), (0.4 * case.u_prev, narrow)):
        theta = (near * case.x, near * case.y_ref, u_prev)
        expected = optimum(hard.problem(hard.emit(*theta, limits=limits)))
        found = optimum(soft.problem(soft.emit(*theta, limits=limits)))
        worst = np.abs(expected.y.reshape(-1, case.problem.model.n_u)).max(axis=0)
        assert (worst < soft.penalty.amplitude).all()
        moves, slacks = blocks(soft, found.z)
        np.testing.assert_allclose(moves.reshape(-1), expected.z, rtol=0, atol=EQUAL)
        np.testing.assert_allclose(slacks, 0.0, atol=EQUAL)


@settings(max_examples=40, derandomize=True, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.1, 4.0), n_u=st.integers(1, 3))
def test_a_penalty_is_exact_from_the_largest_multiplier_on(
    seed: int, size: float, n_u: int
) -> None:
    """1 % above the largest multiplier of the hard problem, not 1 % below it where it is unique."""
    here = at_sea(random_problem(seed, n_u, n_u, 8, 4), seed)
    hard = CondensedQP(here.problem)
    theta = (size * here.x, size * here.y_ref, here.u_prev)
    qp = hard.problem(hard.emit(*theta))
    expected = optimum(qp)
    largest = float(np.abs(expected.y).max())
    # Below it no amplitude limit matters enough for 1 % of its multiplier to move the plan.
    assume(largest > 1e-2)
    rows, (low, high) = np.vstack((qp.A, np.eye(qp.n))), qp.stack_row_and_bound_limits()
    active = rows[np.minimum(rows @ expected.z - low, high - rows @ expected.z) < 1e-9]
    assume(np.linalg.matrix_rank(active) == len(active))
    for factor, same in ((1.01, True), (0.99, False)):
        penalty = Penalty(np.full(n_u, factor * largest), 0.0, 0.3)
        soft = CondensedQP(here.problem, amplitude="soft", penalty=penalty)
        moves, slacks = blocks(soft, optimum(soft.problem(soft.emit(*theta))).z)
        assert bool(np.abs(moves.reshape(-1) - expected.z).max() < EQUAL) is same
        assert bool(slacks.max() < EQUAL) is same


def test_where_hard_limits_are_infeasible_the_soft_plan_violates_them_least() -> None:
    problem, u_prev, limits = lost_thruster()
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.02, 0.0, 0.5, -1.0, 0.02])
    hard = CondensedQP(problem, amplitude="hard")
    empty = hard.problem(hard.emit(x, np.zeros(3), u_prev, limits=limits))
    assert certify(empty).kind == "infeasible"
    soft = CondensedQP(problem, amplitude="soft")
    qp = soft.problem(soft.emit(x, np.zeros(3), u_prev, limits=limits))
    _, slacks = blocks(soft, optimum(qp).z)
    upper, lower = np.isfinite(qp.u), np.isfinite(qp.l)
    cost = np.tile([0.0] * 3 + [1.0] * 3, 10)
    least = linprog(
        cost,
        A_ub=np.vstack([qp.A[upper], -qp.A[lower]]),
        b_ub=np.concatenate([qp.u[upper], -qp.l[lower]]),
        bounds=list(zip(qp.lb, np.where(np.isinf(qp.ub), None, qp.ub), strict=True)),
    )
    # The linear program works to 1e-7 a row; sway starts 21 maximum increments above its limit.
    assert least.fun > 100.0
    assert slacks.sum() == pytest.approx(least.fun, abs=1e-5)


@pytest.mark.parametrize("amplitude", ["hard", "soft"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_hard_and_soft_rows_have_exactly_the_new_limits(amplitude: Any, units: Any) -> None:
    problem, u_prev, limits = lost_thruster()
    builder = CondensedQP(problem, amplitude=amplitude, units=units)
    theta = (np.full(9, 0.01), np.zeros(3), u_prev)
    step = builder.emit(*theta, limits=limits)
    unit = problem.du_max if units == "scaled" else np.ones(3)
    upper, lower = step.u.reshape(10, -1), step.l.reshape(10, -1)
    for found, limit in ((upper[:, :3], limits.high), (lower[:, -3:], limits.low)):
        np.testing.assert_allclose(found * unit, np.tile(limit - u_prev, (10, 1)), rtol=1e-14)
    if amplitude == "soft":
        assert np.isneginf(lower[:, :3]).all() and np.isposinf(upper[:, 3:]).all()
    plain, same = builder.emit(*theta), builder.emit(*theta, limits=problem.limits)
    for name in ("q", "l", "u"):
        # Differences of forces, compared at the size of the limits.
        pair = getattr(same, name), getattr(plain, name)
        np.testing.assert_allclose(*pair, rtol=1e-11, atol=1e-12)


def test_soft_variables_and_rows_shift_by_one_number() -> None:
    problem = ship_problem("supply_fs99")
    builder = CondensedQP(problem, amplitude="soft")
    qp = builder.problem(builder.emit(np.zeros(9), np.zeros(3), np.zeros(3)))
    assert (qp.n, qp.m, qp.block, qp.moves) == (30, 30, 6, 3)
    shorter = CondensedQP(replace(problem, N_c=4), amplitude="soft")
    np.testing.assert_array_equal(qp.A[6:, 6:], shorter.A)
    for name in ("lb", "ub"):
        np.testing.assert_array_equal(getattr(qp, name)[6:], getattr(shorter, name))
    moves = np.random.default_rng(0).normal(size=(5, 3)) * problem.du_max
    np.testing.assert_allclose(
        builder.moves(builder.convert_increments_to_variables(moves)), moves, rtol=1e-14
    )
    assert not blocks(builder, builder.convert_increments_to_variables(moves))[1].any()


def test_slacks_leave_the_cost_of_the_moves_and_the_condition_of_it_alone() -> None:
    problem = ship_problem("supply_fs99", N_p=60, N_c=10, robust=True)
    plain, soft = CondensedQP(problem), CondensedQP(problem, amplitude="soft")
    place = np.arange(soft.n).reshape(10, 6)
    moves, slacks = place[:, :3].reshape(-1), place[:, 3:].reshape(-1)
    np.testing.assert_array_equal(soft.P[np.ix_(moves, moves)], plain.P)
    assert not soft.P[np.ix_(moves, slacks)].any()
    curvature = np.linalg.eigvalsh(plain.P)[0] * np.eye(30)
    np.testing.assert_allclose(soft.P[np.ix_(slacks, slacks)], curvature, rtol=1e-10, atol=0)
    assert np.linalg.cond(soft.P) == pytest.approx(np.linalg.cond(plain.P), rel=1e-9)
    theta = (np.full(9, 0.1), np.zeros(3), np.zeros(3))
    q = soft.emit(*theta).q
    np.testing.assert_array_equal(q[moves], plain.emit(*theta).q)
    assert soft.penalty is not None
    np.testing.assert_array_equal(q[slacks].reshape(10, 3)[4], soft.penalty.amplitude)


def test_soft_problems_in_scaled_and_si_units_have_one_answer() -> None:
    problem, u_prev, limits = lost_thruster()
    scaled, si = (CondensedQP(problem, amplitude="soft", units=u) for u in ("scaled", "si"))  # type: ignore[arg-type] # names from a loop
    theta = (np.full(9, 0.02), np.zeros(3), u_prev)
    qp, raw = (b.problem(b.emit(*theta, limits=limits)) for b in (scaled, si))
    best, unit, row = optimum(qp), si.scale.z, si.scale.row
    z = best.z * unit
    slope = (raw.P @ z + raw.q + raw.A.T @ (best.y / row) + best.y_box / unit) * unit
    np.testing.assert_allclose(slope, 0.0, atol=1e-10 * np.abs(qp.q).max())
    assert raw.objective(z) == pytest.approx(qp.objective(best.z), rel=1e-10)
    np.testing.assert_allclose(si.moves(z), scaled.moves(best.z), rtol=1e-13)
    for in_si, in_steps in ((raw.A @ z, qp.A @ best.z), (raw.l, qp.l), (raw.u, qp.u)):
        np.testing.assert_allclose(in_si, in_steps * row, rtol=1e-9, atol=1e-6)


def test_soft_rows_are_the_forces_within_their_limits_and_slacks() -> None:
    problem, u_prev, limits = lost_thruster()
    builder = CondensedQP(problem, amplitude="soft")
    step = builder.emit(np.zeros(9), np.zeros(3), u_prev, limits=limits)
    rng, seen = np.random.default_rng(3), []
    for _ in range(300):
        slack = rng.uniform(20.5, 28, (10, 3))
        z = np.concatenate([rng.uniform(-1, 1, (10, 3)), slack], axis=1).reshape(-1)
        force, widened = u_prev + np.cumsum(builder.moves(z), axis=0), slack * problem.du_max
        inside = (force <= limits.high + widened) & (force >= limits.low - widened)
        seen.append(inside.all())
        rows = builder.A @ z
        assert ((rows <= step.u) & (rows >= step.l)).all() == seen[-1]
    assert 30 < sum(seen) < 270
