"""One step of the condensed QP: the affine map, memory, reachable limits and units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dpbench.mpc.condense import summed_rows
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.outputs import OutputBounds
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Solution, Status


def pieces(step: QPStep) -> np.ndarray:
    """[q; l; u] copied into one vector."""
    return np.concatenate([step.q, step.l, step.u])


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_a_step_is_affine_in_its_parameters(case: Any, units: Any) -> None:
    """emit(a θ1 + (1 − a) θ2) is the same combination of emit(θ1) and emit(θ2)."""
    builder = CondensedQP(case.problem, units=units)
    first = (case.x, case.y_ref, case.u_prev)
    second = (-0.3 * case.x + 0.1, case.y_ref + 0.2, 0.5 * case.u_prev)
    a = 0.37
    mixed = [a * p + (1 - a) * s for p, s in zip(first, second, strict=True)]
    found = pieces(builder.emit(*mixed))
    expected = a * pieces(builder.emit(*first)) + (1 - a) * pieces(builder.emit(*second))
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


def test_a_step_is_the_map_times_its_parameters(case: Any) -> None:
    """[q; l; u] = Z [x; y_ref; u_prev; 1] for the Z that the builder shows."""
    builder = CondensedQP(case.problem)
    theta = np.concatenate([case.x, case.y_ref, case.u_prev, [1.0]])
    np.testing.assert_allclose(
        pieces(builder.emit(case.x, case.y_ref, case.u_prev)), builder.Z @ theta, rtol=1e-13
    )


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("amplitude", ["reachable", "hard", "soft"])
@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("turning", [False, True])
def test_every_condensed_formulation_is_one_affine_map(
    ship: Any, units: Any, amplitude: Any, bounded: bool, turning: bool
) -> None:
    """At one heading: the map shown makes every step, and steps combine as their parameters do."""
    problem = ship("supply_fs99", N_p=20, N_c=4)
    options: dict[str, Any] = {"units": units, "amplitude": amplitude}
    options["outputs"] = OutputBounds(0.3, 5.0, 0.15) if bounded else None
    builder = (
        RelinearisedQP(problem, psi0_rad=0.0, **options)
        if turning
        else CondensedQP(problem, **options)
    )
    rng = np.random.default_rng(3)
    theta = rng.normal(size=(3, 15)) * np.repeat([0.1, 1e5], [12, 3])
    theta[:, 8] = 0.4
    theta[2] = 0.37 * theta[0] + 0.63 * theta[1]
    steps = [pieces(builder.emit(row[:9], row[9:12], row[12:])) for row in theta]
    finite = np.isfinite(builder.Z[:, -1])
    size = np.abs(builder.Z[finite]) @ np.append(np.abs(theta).max(axis=0), 1.0)
    for row, step in zip(theta, steps, strict=True):
        np.testing.assert_array_equal(step[~finite], builder.Z[~finite, -1])
        apart = np.abs(step[finite] - builder.Z[finite] @ np.append(row, 1.0))
        assert (apart <= 1e-14 * size).all()
    mixed = 0.37 * steps[0][finite] + 0.63 * steps[1][finite]
    assert (np.abs(mixed - steps[2][finite]) <= 1e-14 * size).all()


def test_a_step_stays_valid_and_leaves_its_inputs_alone(case: Any) -> None:
    """Later steps, previewed or limited, write neither into an earlier step nor into arguments."""
    builder = CondensedQP(case.problem)
    arguments = (case.x.copy(), case.preview(), case.u_prev.copy())
    limits = Limits(0.5 * case.problem.u_min, 0.5 * case.problem.u_max)
    saved = [a.copy() for a in (*arguments, *limits)]
    matrices = [a.copy() for a in (builder.P, builder.A, builder.lb, builder.ub, builder.Z)]
    first = builder.emit(*arguments, limits=limits)
    kept = pieces(first)
    builder.emit(0 * case.x, case.y_ref, 0 * case.u_prev)
    builder.emit(case.x + 1.0, case.preview(), 0.5 * case.u_prev, limits=limits)
    np.testing.assert_array_equal(pieces(first), kept)
    for now, then in zip((*arguments, *limits), saved, strict=True):
        np.testing.assert_array_equal(now, then)
    for now, then in zip(
        (builder.P, builder.A, builder.lb, builder.ub, builder.Z), matrices, strict=True
    ):
        np.testing.assert_array_equal(now, then)
    first.q[:] = np.nan
    assert np.isfinite(pieces(builder.emit(*arguments))).all()


def test_a_step_brings_vectors_only(case: Any) -> None:
    """P, A, lb and ub are constant, so a step says that only vectors changed."""
    step = CondensedQP(case.problem).emit(case.x, case.y_ref, case.u_prev)
    assert step.refresh is Refresh.VECTORS


def test_a_previewed_constant_reference_is_the_held_one(case: Any) -> None:
    """A reference (N_p, n_y) with equal rows gives the step of the reference (n_y,)."""
    builder = CondensedQP(case.problem)
    held = builder.emit(case.x, case.y_ref, case.u_prev)
    previewed = builder.emit(case.x, case.held, case.u_prev)
    np.testing.assert_array_equal(pieces(previewed), pieces(held))
    assert builder.constant_cost(case.x, case.held) == builder.constant_cost(case.x, case.y_ref)


def test_a_preview_of_another_length_is_refused(ship: Any) -> None:
    """A preview of other than N_p rows does not fit and raises."""
    builder = CondensedQP(ship("supply_fs99"))
    with pytest.raises(ValueError, match=r"mismatch|shapes|align"):
        builder.emit(np.zeros(9), np.zeros((29, 3)), np.zeros(3))


def test_moves_and_plan_are_inverse(case: Any) -> None:
    """z → moves → z changes nothing, and one unit of scaled z is one rate-limit step."""
    scaled, si = CondensedQP(case.problem), CondensedQP(case.problem, units="si")
    z = case.rng.normal(size=scaled.n)
    for builder in (scaled, si):
        np.testing.assert_allclose(builder.plan(builder.moves(z)), z, rtol=1e-15)
    expected = z.reshape(case.problem.N_c, -1) * case.problem.du_max
    np.testing.assert_allclose(scaled.moves(z), expected, rtol=1e-15)
    np.testing.assert_array_equal(si.moves(z), z.reshape(case.problem.N_c, -1))


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("factor", [1.0, 0.45])
def test_reachable_limits_follow_the_rate_row_by_row(case: Any, units: Any, factor: float) -> None:
    """Plan row i allows max(u_max, u_prev − iΔu_max) above and min(u_min, u_prev + iΔu_max) below.

    At factor 0.45 the limits have dropped below the force applied, the case of a lost thruster.
    """
    problem = case.problem
    u_min, u_max = factor * problem.u_min, factor * problem.u_max
    builder = CondensedQP(problem, units=units)
    step = builder.emit(case.x, case.y_ref, case.u_prev, limits=Limits(u_min, u_max))
    plain = builder.emit(case.x, case.y_ref, case.u_prev)
    np.testing.assert_array_equal(step.q, plain.q)
    low, high = builder.moves(step.l), builder.moves(step.u)
    for i in range(problem.N_c):
        for axis in range(problem.model.n_u):
            before, rate = case.u_prev[axis], problem.du_max[axis]
            # Compared as forces, so rounding is relative to the amplitude limit.
            size = 1e-12 * (problem.u_max[axis] - problem.u_min[axis])
            reachable = max(u_max[axis], before - (i + 1) * rate)
            assert before + high[i, axis] == pytest.approx(reachable, abs=size)
            reachable = min(u_min[axis], before + (i + 1) * rate)
            assert before + low[i, axis] == pytest.approx(reachable, abs=size)
    if factor == 1.0:
        np.testing.assert_allclose(pieces(step), pieces(plain), rtol=1e-12, atol=1e-9)


def test_reachable_limits_always_leave_a_feasible_plan(case: Any) -> None:
    """Moving towards the new limits at full rate, and no further, satisfies every row."""
    problem = case.problem
    u_min, u_max = 0.3 * problem.u_min, 0.3 * problem.u_max
    builder = CondensedQP(problem)
    step = builder.emit(case.x, case.y_ref, case.u_prev, limits=Limits(u_min, u_max))
    force, moves = case.u_prev, []
    for _ in range(problem.N_c):
        target = np.clip(force, u_min, u_max)
        moves.append(np.clip(target - force, -problem.du_max, problem.du_max))
        force = force + moves[-1]
    z = builder.plan(np.array(moves))
    tolerance = 1e-9
    assert (builder.A @ z <= step.u + tolerance).all()
    assert (builder.A @ z >= step.l - tolerance).all()


def test_the_hard_problem_after_a_lost_thruster_has_no_feasible_point(
    ship: Any, by_quadprog: Any
) -> None:
    """A sway limit that falls to 45 % under full thrust is out of reach of the rate limit, while
    the reachable limits lead down to it one rate step a row."""
    problem = ship("supply_fs99", N_p=60, N_c=10, robust=True)
    share = np.array([1.0, 0.45, 0.6])
    limits = Limits(problem.u_min * share, problem.u_max * share)
    u_prev = np.array([0.0, problem.u_max[1], 0.0])
    builder = CondensedQP(problem)
    step = builder.emit(np.zeros(9), np.zeros(3), u_prev, limits=limits)
    hard = QPStep(
        step.q,
        np.tile((limits[0] - u_prev) / problem.du_max, 10),
        np.tile((limits[1] - u_prev) / problem.du_max, 10),
    )
    with pytest.raises(ValueError, match="inconsistent"):
        by_quadprog(builder.problem(hard))
    # Rows that are forced to their bounds leave no interior, where Goldfarb-Idnani may give up.
    z = certify(builder.problem(step)).z
    np.testing.assert_allclose(step.u.reshape(10, 3)[:, 1], -np.arange(1.0, 11.0), rtol=1e-12)
    np.testing.assert_allclose(builder.moves(z)[:, 1], -problem.du_max[1], rtol=1e-9)


def test_scaled_and_si_problems_have_one_answer(case: Any, by_quadprog: Any) -> None:
    """Both systems of units have the same plan, cost and, mapped, the same multipliers."""
    scaled, si = CondensedQP(case.problem), CondensedQP(case.problem, units="si")
    theta = (case.x, case.y_ref, case.u_prev)
    problem = scaled.problem(scaled.emit(*theta))
    z, y, y_box = by_quadprog(problem)
    raw = si.problem(si.emit(*theta))
    own = Solution(
        Status.SOLVED, z * si.scale.z, y / si.scale.row, y_box / si.scale.z, 7, 11, "words"
    )
    # Stationarity of the mapped answer in the SI problem, each row in its own unit.
    slope = raw.P @ own.z + raw.q + raw.A.T @ own.y + own.y_box
    size = 1.0 + np.abs(problem.q).max()
    np.testing.assert_allclose(slope * si.scale.z, 0.0, atol=1e-10 * size)
    assert raw.objective(own.z) == pytest.approx(problem.objective(z), rel=1e-9)
    np.testing.assert_allclose(si.moves(own.z), scaled.moves(z), rtol=1e-14)
    # Solved on its own in N and N·m, where P has a condition of up to 1e5, the plan is the same.
    alone = si.moves(by_quadprog(raw)[0]) / case.problem.du_max
    np.testing.assert_allclose(alone, scaled.moves(z) / case.problem.du_max, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["supply_fs99", "supply_tmr"])
def test_amplitude_rows_beyond_the_control_horizon_change_nothing(
    ship: Any, point: Any, by_quadprog: Any, name: str
) -> None:
    """Rows for u(k+N_c) … u(k+N_p−1) are redundant, because the plan stands still there."""
    here = point(ship(name, psi0_rad=0.4, N_p=30, N_c=5))
    builder = CondensedQP(here.problem)
    qp = builder.problem(builder.emit(here.x, here.y_ref, here.u_prev))
    # One row per axis and instant up to N_p, each the sum of all moves made so far.
    rows = np.zeros((30, 3, 5, 3))
    for i in range(30):
        for j in range(min(i + 1, 5)):
            rows[i, :, j, :] = np.eye(3)
    limit = [
        (bound - here.u_prev) / here.problem.du_max
        for bound in (here.problem.u_min, here.problem.u_max)
    ]
    longer = QuadraticProgram(
        qp.P, qp.q, rows.reshape(90, 15), np.tile(limit[0], 30), np.tile(limit[1], 30), qp.lb, qp.ub
    )
    z, y, _ = by_quadprog(qp)
    assert np.abs(y).max() > 0.0
    np.testing.assert_allclose(by_quadprog(longer)[0], z, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(longer.A[:15], summed_rows(5, np.eye(3)))
