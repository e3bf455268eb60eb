"""Policies of the amplitude limits: hard, reachable and soft with an exact penalty."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from dpbench.errors import InputError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.soft_limits import Penalty
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QuadraticProgram, Refresh
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Solution, Status

LOST = np.array([1.0, 0.45, 0.6])
"""What is left of the limits in `thruster_loss`."""
EQUAL = 1e-9
"""The largest difference of two plans called equal, in rate-limit steps; both are certified to
1e-10 or better."""


def optimum(qp: QuadraticProgram) -> Optimum:
    """The certified optimum."""
    found = certify(qp)
    assert found.bound < 1e-10
    return found


def blocks(builder: CondensedQP, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moves (N_c, n_u) and slacks (N_c, n_u) of a scaled answer."""
    rows = z.reshape(builder.control.N_c, -1)
    n_u = builder.control.model.n_u
    return rows[:, :n_u], rows[:, n_u:]


def lost_thruster(ship: Any) -> tuple[Any, np.ndarray, Limits]:
    """A robust controller, full sway force applied, and the limits that are left."""
    problem = ship("supply_fs99", N_p=60, N_c=10, robust=True)
    u_prev = np.array([0.0, problem.u_max[1], 0.2 * problem.u_max[2]])
    return problem, u_prev, Limits(problem.u_min * LOST, problem.u_max * LOST)


def test_where_hard_limits_are_feasible_the_soft_plan_is_the_hard_one(case: Any) -> None:
    """With the default penalty no slack is used and the moves are those of the hard problem, for
    the limits of the vessel and for narrower ones, as long as no move of the unconstrained plan
    exceeds the quarter of the amplitude range that the default allows for."""
    hard, soft = CondensedQP(case.problem), CondensedQP(case.problem, amplitude="soft")
    free = np.linalg.solve(hard.P, hard.emit(case.x, case.y_ref, case.u_prev).q)
    span = (case.problem.u_max - case.problem.u_min) / case.problem.du_max
    near = min(1.0, 0.25 * float(span.min()) / np.abs(free).max())
    narrow = Limits(0.5 * case.problem.u_min, 0.5 * case.problem.u_max)
    for u_prev, limits in ((case.u_prev, None), (0.4 * case.u_prev, narrow)):
        theta = (near * case.x, near * case.y_ref, u_prev)
        expected = optimum(hard.problem(hard.emit(*theta, limits=limits)))
        found = optimum(soft.problem(soft.emit(*theta, limits=limits)))
        assert soft.penalty is not None
        worst = np.abs(expected.y.reshape(-1, case.problem.model.n_u)).max(axis=0)
        assert (worst < soft.penalty.amplitude).all()
        moves, slacks = blocks(soft, found.z)
        np.testing.assert_allclose(moves.reshape(-1), expected.z, rtol=0, atol=EQUAL)
        np.testing.assert_allclose(slacks, 0.0, atol=EQUAL)


@settings(max_examples=40, derandomize=True, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.1, 4.0), n_u=st.integers(1, 3))
def test_a_penalty_is_exact_from_the_largest_multiplier_on(
    seed: int, size: float, n_u: int, random_plant: Any, point: Any
) -> None:
    """A penalty 1 % above the largest multiplier of the hard problem gives the hard plan, whatever
    its curvature; one 1 % below it does not, where the multipliers are the only ones."""
    here = point(random_plant(seed, n_u, n_u, 8, 4), seed)
    hard = CondensedQP(here.problem)
    theta = (size * here.x, size * here.y_ref, here.u_prev)
    qp = hard.problem(hard.emit(*theta))
    expected = optimum(qp)
    largest = float(np.abs(expected.y).max())
    # Below it no amplitude limit matters enough for 1 % of its multiplier to move the plan.
    assume(largest > 1e-2)
    value = np.concatenate((qp.A @ expected.z, expected.z))
    limits = np.concatenate((qp.l, qp.lb)), np.concatenate((qp.u, qp.ub))
    active = np.minimum(value - limits[0], limits[1] - value) < 1e-9
    rows = np.vstack((qp.A, np.eye(qp.n)))[active]
    assume(np.linalg.matrix_rank(rows) == len(rows))
    for factor, same in ((1.01, True), (0.99, False)):
        penalty = Penalty(np.full(n_u, factor * largest), 0.0, 0.3)
        soft = CondensedQP(here.problem, amplitude="soft", penalty=penalty)
        found = optimum(soft.problem(soft.emit(*theta)))
        moves, slacks = blocks(soft, found.z)
        assert bool(np.abs(moves.reshape(-1) - expected.z).max() < EQUAL) is same
        assert bool(slacks.max() < EQUAL) is same


def test_where_hard_limits_are_infeasible_the_soft_plan_violates_them_least(ship: Any) -> None:
    """After a thruster is lost, the hard step has no plan and the slacks of the soft one add up to
    the least that a linear program finds."""
    problem, u_prev, limits = lost_thruster(ship)
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
    # The linear program works to 1e-7 a row; sway starts 21 rate-limit steps above its limit.
    assert least.fun > 100.0
    assert slacks.sum() == pytest.approx(least.fun, abs=1e-5)


def test_soft_rows_are_the_forces_within_their_limits_and_slacks(ship: Any) -> None:
    """A plan meets the rows exactly when every force of it, added up move by move, is within the
    limits in force widened by the slack of its axis."""
    problem, u_prev, (u_min, u_max, _) = lost_thruster(ship)
    builder = CondensedQP(problem, amplitude="soft")
    step = builder.emit(np.zeros(9), np.zeros(3), u_prev, limits=Limits(u_min, u_max))
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(300):
        slack = rng.uniform(20.5, 28, (10, 3))
        z = np.concatenate([rng.uniform(-1, 1, (10, 3)), slack], axis=1).reshape(-1)
        force, inside = u_prev, True
        for moves, widened in zip(builder.moves(z), slack * problem.du_max, strict=True):
            force = force + moves
            inside &= bool((force <= u_max + widened).all() and (force >= u_min - widened).all())
        value = builder.A @ z
        assert bool((value <= step.u).all() and (value >= step.l).all()) is inside
        met += inside
    assert 30 < met < 270


@pytest.mark.parametrize("amplitude", ["hard", "soft"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_new_limits_stand_exactly_in_hard_and_soft_rows(
    ship: Any, amplitude: Any, units: Any
) -> None:
    """Every plan row asks for the new limits less the force applied, however far that is."""
    problem, u_prev, (u_min, u_max, _) = lost_thruster(ship)
    builder = CondensedQP(problem, amplitude=amplitude, units=units)
    theta = (np.full(9, 0.01), np.zeros(3), u_prev)
    step = builder.emit(*theta, limits=Limits(u_min, u_max))
    unit = problem.du_max if units == "scaled" else np.ones(3)
    upper = step.u.reshape(10, -1)[:, :3] * unit
    lower = step.l.reshape(10, -1)[:, -3:] * unit
    np.testing.assert_allclose(upper, np.tile(u_max - u_prev, (10, 1)), rtol=1e-14)
    np.testing.assert_allclose(lower, np.tile(u_min - u_prev, (10, 1)), rtol=1e-14)
    if amplitude == "soft":
        assert np.isneginf(step.l.reshape(10, 6)[:, :3]).all()
        assert np.isposinf(step.u.reshape(10, 6)[:, 3:]).all()
    plain = builder.emit(*theta)
    same = builder.emit(*theta, limits=Limits(problem.u_min, problem.u_max))
    for name in ("q", "l", "u"):
        # Differences of forces, compared at the size of the limits.
        np.testing.assert_allclose(
            getattr(same, name), getattr(plain, name), rtol=1e-11, atol=1e-12
        )


def test_soft_variables_and_rows_shift_by_one_number(ship: Any) -> None:
    """Six variables and six rows a move, moves first: without its first block the problem has the
    rows of the problem that is one move shorter."""
    problem = ship("supply_fs99")
    builder = CondensedQP(problem, amplitude="soft")
    qp = builder.problem(builder.emit(np.zeros(9), np.zeros(3), np.zeros(3)))
    assert (qp.n, qp.m, qp.block, qp.moves) == (30, 30, 6, 3)
    shorter = CondensedQP(replace(problem, N_c=4), amplitude="soft")
    np.testing.assert_array_equal(qp.A[6:, 6:], shorter.A)
    for name in ("lb", "ub"):
        np.testing.assert_array_equal(getattr(qp, name)[6:], getattr(shorter, name))
    moves = np.random.default_rng(0).normal(size=(5, 3)) * problem.du_max
    np.testing.assert_allclose(builder.moves(builder.plan(moves)), moves, rtol=1e-14)
    assert not blocks(builder, builder.plan(moves))[1].any()


def test_slacks_leave_the_cost_of_the_moves_and_the_condition_of_it_alone(ship: Any) -> None:
    """P is that of the plain problem over the moves and couples no slack, whose curvature is its
    smallest eigenvalue, so that it is as well conditioned; q charges every slack its penalty."""
    problem = ship("supply_fs99", N_p=60, N_c=10, robust=True)
    plain, soft = CondensedQP(problem), CondensedQP(problem, amplitude="soft")
    place = np.arange(soft.n).reshape(10, 6)
    moves, slacks = place[:, :3].reshape(-1), place[:, 3:].reshape(-1)
    np.testing.assert_array_equal(soft.P[np.ix_(moves, moves)], plain.P)
    assert not soft.P[np.ix_(moves, slacks)].any()
    smallest = np.linalg.eigvalsh(plain.P)[0]
    np.testing.assert_allclose(
        soft.P[np.ix_(slacks, slacks)], smallest * np.eye(30), rtol=1e-10, atol=0
    )
    assert np.linalg.cond(soft.P) == pytest.approx(np.linalg.cond(plain.P), rel=1e-9)
    theta = (np.full(9, 0.1), np.zeros(3), np.zeros(3))
    q = soft.emit(*theta).q
    np.testing.assert_array_equal(q[moves], plain.emit(*theta).q)
    assert soft.penalty is not None
    np.testing.assert_array_equal(q[slacks].reshape(10, 3)[4], soft.penalty.amplitude)


def test_a_soft_step_is_one_affine_map(case: Any) -> None:
    """[q; l; u] = Z [x; y_ref; u_prev; 1] with its infinite limits, vectors only."""
    builder = CondensedQP(case.problem, amplitude="soft")
    theta = np.concatenate([case.x, case.y_ref, case.u_prev, [1.0]])
    step = builder.emit(case.x, case.y_ref, case.u_prev)
    found = np.concatenate([step.q, step.l, step.u])
    finite = np.isfinite(builder.Z[:, -1])
    np.testing.assert_array_equal(found[~finite], builder.Z[~finite, -1])
    np.testing.assert_allclose(found[finite], builder.Z[finite] @ theta, rtol=1e-13, atol=1e-12)
    assert step.refresh is Refresh.VECTORS


def test_soft_problems_in_scaled_and_si_units_have_one_answer(ship: Any) -> None:
    """The optimum of a violated step, mapped to SI, is optimal there: stationary, with the same
    cost and moves."""
    problem, u_prev, limits = lost_thruster(ship)
    scaled = CondensedQP(problem, amplitude="soft")
    si = CondensedQP(problem, amplitude="soft", units="si")
    theta = (np.full(9, 0.02), np.zeros(3), u_prev)
    qp, raw = (b.problem(b.emit(*theta, limits=limits)) for b in (scaled, si))
    best = optimum(qp)
    own = Solution(
        Status.SOLVED, best.z * si.scale.z, best.y / si.scale.row, best.y_box / si.scale.z
    )
    slope = (raw.P @ own.z + raw.q + raw.A.T @ own.y + own.y_box) * si.scale.z
    np.testing.assert_allclose(slope, 0.0, atol=1e-10 * np.abs(qp.q).max())
    assert raw.objective(own.z) == pytest.approx(qp.objective(best.z), rel=1e-10)
    np.testing.assert_allclose(si.moves(own.z), scaled.moves(best.z), rtol=1e-13)
    rows = ((raw.A @ own.z, qp.A @ best.z), (raw.l, qp.l), (raw.u, qp.u))
    for in_si, in_steps in rows:
        np.testing.assert_allclose(in_si, in_steps * si.scale.row, rtol=1e-9, atol=1e-6)


def test_unknown_policies_are_refused(ship: Any) -> None:
    """The policy is "reachable", "hard" or "soft"."""
    with pytest.raises(InputError, match='\'firm\'; allowed: "reachable", "hard" or "soft"'):
        CondensedQP(ship("supply_fs99"), amplitude="firm")  # type: ignore[arg-type] # bad on purpose
